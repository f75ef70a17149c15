//! Units in the names of fields: `p1 [bar]`, `Valve (V)`, `position_mm`, `flow_l_per_min`.

/// Words that stand for a unit where a name ends in them after a divider. Others, such as `a`, `c` and `in`, are as often a port's, a
/// chamber's and an inlet's, and are only believed in brackets.
const ENDINGS: &[&str] = &[
    "m", "mm", "cm", "um", "µm", "inch", "bar", "mbar", "pa", "hpa", "kpa", "mpa", "psi", "v", "mv", "volt",
    "volts", "ma", "n", "kn", "lbf", "kgf", "kg", "degc", "celsius", "rad", "deg", "rpm", "hz", "s", "ms",
    "us", "ns", "pct", "percent", "prozent", "%", "lpm", "inc", "counts", "digits", "w", "kw",
];

/// The unit that a name tells, as it is written there.
pub(super) fn unit_in_name(name: &str) -> Option<String> {
    in_brackets(name).or_else(|| after_divider(name))
}

fn in_brackets(name: &str) -> Option<String> {
    let [open, close] = match name.trim_end().chars().last()? {
        ']' => ['[', ']'],
        ')' => ['(', ')'],
        _ => return None,
    };
    let text = name.trim_end().strip_suffix(close)?.rsplit_once(open)?.1.trim();
    // An index is no unit.
    let is_unit = !text.is_empty() && text.chars().any(|c| !c.is_ascii_digit());
    is_unit.then(|| text.to_owned())
}

fn after_divider(name: &str) -> Option<String> {
    let words: Vec<&str> =
        name.split(|c: char| !(c.is_alphanumeric() || c == '%')).filter(|word| !word.is_empty()).collect();
    if let Some(per) = words.iter().position(|word| word.eq_ignore_ascii_case("per"))
        && let (Some(above), Some(below)) =
            (per.checked_sub(1).and_then(|at| words.get(at)), words.get(per + 1))
    {
        return Some(format!("{above}/{below}"));
    }
    let last = words.last().filter(|_| words.len() > 1)?;
    ENDINGS.contains(&last.to_lowercase().as_str()).then(|| (*last).to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_stand_in_brackets_or_after_a_divider() {
        for (name, unit) in [
            ("p1 [bar]", Some("bar")),
            ("Valve (V)", Some("V")),
            ("axis.position_mm", Some("mm")),
            ("Druck_kPa", Some("kPa")),
            ("flow_l_per_min", Some("l/min")),
            ("speed [mm/s]", Some("mm/s")),
            ("Ventil %", Some("%")),
            ("data[3]", None),
            ("p_a", None),
            ("p_in", None),
            ("m", None),
            ("command", None),
        ] {
            assert_eq!(unit_in_name(name).as_deref(), unit, "{name}");
        }
    }
}
