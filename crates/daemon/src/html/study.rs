//! The page that `seepd study` leaves.

use maud::{Markup, html};
use seepd_study::Study;
use seepd_study::claims::Agreement;
use seepd_study::cycles::REFERENCE_DP_PA;
use seepd_study::ensemble::{EnsembleAccuracy, LEARNERS, OBSERVATIONS};
use seepd_study::features::{FIVE, FeatureCurve};
use seepd_study::holding::{ACCURATE_WITHIN_M, ARTICLE_LPM, Hold};

use super::chart::{Axis, Chart, Layer, Size, number};
use super::page;
use crate::quantity::{MM2_PER_M2, bar, mm2, percent};

/// Curves of one figure from light to dark.
const SHADES: [&str; 6] = ["shade-0", "shade-1", "shade-2", "shade-3", "shade-4", "shade-5"];

/// What the page shows.
pub struct StudyPage<'a> {
    /// The study.
    pub study: &'a Study,
}

impl StudyPage<'_> {
    /// A line a figure, for the terminal.
    pub fn outcomes(&self) -> String {
        let lines = self.study.claims.iter();
        lines
            .map(|verdict| format!("{}: {}. {}\n", verdict.figure, verdict.agreement.name(), verdict.text))
            .collect()
    }

    /// The page's text.
    pub fn render(&self) -> String {
        let body = html! {
            h1 { "The article's figures, made again" }
            p { "The source article (" em { "Characterization of Leakage Fault in Hydraulic Cylinders Leading to Sustainable Maintenance Planning of Equipment" }
                ") prints its equations with errors. This page shows its experiments on the corrected plant, at 1 kHz, with duty cycles of 10 s and, unless stated \
                otherwise, with measurement noise of 0.001 on the command. Each figure is marked with whether it agrees with the article's text." }
            h2 { "Figure 2: demand and load" }
            (self.verdict("figure 2"))
            div.grid-2 { (self.demand()) (self.load()) }
            h2 { "Figure 5: the command under leaks" }
            (self.verdict("figure 5"))
            (self.commands())
            h2 { "Figure 6: leak rate by area" }
            (self.verdict("figure 6"))
            (self.leak_rates())
            h2 { "Figure 7: features by area" }
            (self.verdict("figure 7"))
            div.grid-3 { @for curve in &self.study.features.curves { (self.feature(curve)) } }
            (self.feature_table())
            h2 { "Figures 8 and 9: noise, without and with the Kalman filter" }
            (self.verdict("figures 8 and 9"))
            p.soft { "Change of each feature from its value at noise 0.001, in % of its range over the leaks, by leak area. The redder a line, the larger the noise ("
                (self.study.noise.noise.iter().skip(1).map(f64::to_string).collect::<Vec<_>>().join(", ")) "). Both figures have the same scales." }
            h3 { "Figure 8: without the filter" }
            div.grid-3 { @for index in 0..FIVE.len() { (self.noisy(index, &changes(&self.study.noise.without[index]))) } }
            h3 { "Figure 9: with the filter" }
            div.grid-3 { @for index in 0..FIVE.len() { (self.noisy(index, &changes(&self.study.noise.with[index]))) } }
            (self.change_table())
            (self.error_by_noise())
            h2 { "The article's ensemble and this program's" }
            (self.verdict("ensemble"))
            (self.ensemble_table())
            h2 { "The largest leak that the controller holds" }
            (self.verdict("largest leak held"))
            (self.holding())
            (self.holding_table())
            h2 { "What was corrected in the article" }
            (corrections())
            p.soft { "Made by " code { "seepd study --seed " (self.study.seed) } "." }
        };
        page("The article's figures, made again – seepd", &body)
    }

    fn verdict(&self, figure: &str) -> Markup {
        let verdict = self.study.claims.iter().find(|verdict| verdict.figure == figure);
        html! { @if let Some(verdict) = verdict {
            @let colour = match verdict.agreement {
                Agreement::Agrees => "var(--healthy)", Agreement::Partly => "var(--watch)", Agreement::Differs => "var(--severe)",
            };
            p { span.tag style=(format!("background:{colour}")) { (verdict.agreement.name()) } " " (verdict.text) }
        } }
    }

    fn demand(&self) -> Markup {
        let healthy = &self.study.cycles[0];
        let points = |values: &[f64]| healthy.t_s.iter().copied().zip(values.iter().copied()).collect();
        Chart {
            size: Size::Half,
            layers: vec![
                Layer::Line { class: "stroke-a", points: points(&healthy.demand_m) },
                Layer::Line { class: "stroke-b dash", points: points(&healthy.position_m) },
            ],
            key: vec![("demand".into(), "var(--a)", false), ("position, healthy".into(), "var(--b)", false)],
            ..Chart::new("Demand and position", self.time(), Axis::linear("m", 0.0, 0.42))
        }
        .render()
    }

    fn load(&self) -> Markup {
        let healthy = &self.study.cycles[0];
        let points = healthy.t_s.iter().zip(&healthy.load_n).map(|(t, n)| (*t, n / 1e3)).collect();
        Chart {
            size: Size::Half,
            layers: vec![Layer::Line { class: "stroke-a", points }],
            key: vec![("load, positive in the extending direction".into(), "var(--a)", false)],
            ..Chart::new("Load", self.time(), Axis::linear("kN", -18.0, 2.0))
        }
        .render()
    }

    fn time(&self) -> Axis {
        let end = self.study.cycles[0].t_s.last().copied().unwrap_or(10.0);
        Axis::linear("time in the cycle, s", 0.0, end.ceil())
    }

    fn commands(&self) -> Markup {
        let all = || self.study.cycles.iter().flat_map(|curve| &curve.command);
        let limit = all().map(|command| command.abs()).fold(0.1, f64::max) * 1.05;
        let line = |(index, curve): (usize, &seepd_study::cycles::CycleCurve)| Layer::Line {
            class: SHADES[index.min(5)],
            points: curve.t_s.iter().copied().zip(curve.command.iter().copied()).collect(),
        };
        Chart {
            layers: self.study.cycles.iter().enumerate().map(line).collect(),
            key: self
                .study
                .cycles
                .iter()
                .enumerate()
                .map(|(index, curve)| {
                    (format!("{} mm²", number(curve.leak_area_m2 * MM2_PER_M2)), shade_colour(index), false)
                })
                .collect(),
            ..Chart::new("Valve command by time", self.time(), Axis::linear("valve command", -limit, limit))
        }
        .render()
    }

    fn area(&self) -> Axis {
        let (least_m2, most_m2) = seepd_study::AREAS_M2;
        Axis::logarithmic("leak area, mm²", least_m2 * MM2_PER_M2, most_m2 * MM2_PER_M2)
    }

    fn leak_rates(&self) -> Markup {
        let rates = &self.study.leak_rates;
        let line = |pick: &dyn Fn(&seepd_study::cycles::LeakRate) -> f64| {
            rates.iter().map(|rate| (rate.leak_area_m2 * MM2_PER_M2, pick(rate))).collect()
        };
        Chart {
            layers: vec![
                Layer::Limit {
                    at: ARTICLE_LPM,
                    name: format!("the article's {ARTICLE_LPM} L/min"),
                    colour: "var(--leak)",
                },
                Layer::Line { class: "stroke-soft dash", points: line(&|rate| rate.orifice_lpm) },
                Layer::Line { class: "stroke-b", points: line(&|rate| rate.peak_lpm) },
                Layer::Line { class: "stroke-a", points: line(&|rate| rate.mean_lpm) },
            ],
            key: vec![
                ("mean over a cycle".into(), "var(--a)", false),
                ("peak".into(), "var(--b)", false),
                (format!("orifice at {} bar", bar(REFERENCE_DP_PA)), "var(--soft)", false),
            ],
            ..Chart::new("Leak rate by area", self.area(), Axis::logarithmic("leak, L/min", 0.1, 100.0))
        }
        .render()
    }

    fn feature(&self, curve: &FeatureCurve) -> Markup {
        let areas = in_mm2(&self.study.features.leak_area_m2);
        Chart {
            size: Size::Small,
            layers: vec![Layer::Points {
                class: "dot-a",
                points: areas.into_iter().zip(curve.values.iter().copied()).collect(),
            }],
            ..Chart::new(&curve.name.replace('_', " "), self.area(), spanning(curve.values.iter().copied()))
        }
        .render()
    }

    fn feature_table(&self) -> Markup {
        html! { div.scroll { table {
            thead { tr { th { "Feature" } th.number { "at 0.05 mm²" } th.number { "at 10 mm²" } th.number { "rank correlation" } th.number { "net share of its way" } } }
            tbody { @for curve in &self.study.features.curves { tr {
                td { (curve.name.replace('_', " ")) }
                td.number { (curve.values.first().map_or(String::new(), |value| format!("{value:.4}"))) }
                td.number { (curve.values.last().map_or(String::new(), |value| format!("{value:.4}"))) }
                td.number { (format!("{:.3}", curve.rank_correlation)) }
                td.number { (percent(curve.net_share, 0)) }
            } } }
        } } p.soft { "A curve that only rises or only falls has a rank correlation (Spearman) of ±1, and a net share of its way of 100 %: it never turns back." } }
    }

    fn noisy(&self, index: usize, levels: &[Vec<f64>]) -> Markup {
        let areas = in_mm2(&self.study.noise.leak_area_m2);
        let line = |(level, values): (usize, &Vec<f64>)| Layer::Line {
            class: SHADES[(level + 2).min(5)],
            points: areas.iter().copied().zip(values.iter().copied()).collect(),
        };
        let both =
            [&self.study.noise.without[index], &self.study.noise.with[index]].map(|levels| changes(levels));
        Chart {
            size: Size::Small,
            layers: levels.iter().enumerate().map(line).collect(),
            ..Chart::new(
                &FIVE[index].replace('_', " "),
                self.area(),
                spanning(both.iter().flatten().flatten().copied()),
            )
        }
        .render()
    }

    fn change_table(&self) -> Markup {
        html! { div.scroll { table {
            thead { tr { th { "Feature" } th.number { "change without the filter" } th.number { "with the filter" } } }
            tbody { @for (name, change) in FIVE.iter().zip(&self.study.noise.change) { tr {
                td { (name.replace('_', " ")) }
                @for value in change { td.number { (percent(*value, 3)) } }
            } } }
        } } p.soft { "RMS change from noise 0.001 to 0.01, share of the feature's range over the leaks." } }
    }

    /// Error of the article's ensemble by noise, without the filter and with it.
    fn error_by_noise(&self) -> Markup {
        let of = |list: &[EnsembleAccuracy]| -> Vec<(f64, f64)> {
            let own = list.iter().filter(|line| line.ensemble == "article" && line.machines == "press");
            own.map(|line| (line.noise, line.mean_absolute_error_m2 * MM2_PER_M2)).collect()
        };
        let without = of(&self.study.ensembles.article_unfiltered);
        let with = of(&self.study.ensembles.accuracy);
        let highest = without.iter().chain(&with).map(|point| point.1).fold(0.0, f64::max);
        Chart {
            layers: vec![
                Layer::Line { class: "stroke-b", points: without },
                Layer::Line { class: "stroke-a", points: with },
            ],
            key: vec![
                ("without the filter".into(), "var(--b)", false),
                ("with the filter".into(), "var(--a)", false),
            ],
            ..Chart::new(
                "Error of the article's ensemble by noise",
                Axis::linear("noise of the command", 0.0, 0.0105),
                Axis::linear("mean absolute error, mm²", 0.0, 1.1 * highest),
            )
        }
        .render()
    }

    fn ensemble_table(&self) -> Markup {
        let name = |line: &EnsembleAccuracy| match line.ensemble {
            "article" => "article's",
            _ => "this program's",
        };
        let machines = |line: &EnsembleAccuracy| match line.machines {
            "press" => "the article's own press",
            _ => "others, ±\u{a0}5\u{a0}%",
        };
        html! { div.scroll { table {
            thead { tr { th { "Ensemble" } th { "on" } th.number { "noise" } th.number { "R²" } th.number { "mean error, mm²" }
                th.number { "median error 0.05…0.1" } th.number { "0.1…1" } th.number { "1…10 mm²" } } }
            tbody { @for line in &self.study.ensembles.accuracy { tr {
                td { (name(line)) }
                td { (machines(line)) }
                td.number { (line.noise) }
                td.number { (format!("{:.5}", line.r2)) }
                td.number { (mm2(line.mean_absolute_error_m2)) }
                @for error in line.median_relative_error { td.number { (percent(error, 2)) } }
            } } }
        } } p.soft { "Leaks are spread evenly over the decades, on " (self.study.ensembles.accuracy.first().map_or(0, |line| line.count)) " machines each, with the Kalman filter. The \
            article's ensemble has " (FIVE.len()) " features and " (LEARNERS) " learners, and learned from " (OBSERVATIONS) " observations whose areas are spread evenly over the range, at noise 0.001." } }
    }

    fn holding(&self) -> Markup {
        let holding = &self.study.holding;
        let area = |hold: &Hold| hold.leak_area_m2 * MM2_PER_M2;
        let points = holding.sweep.iter().map(|hold| (area(hold), 1e3 * hold.added_error_m)).collect();
        let (first, last) = (&holding.sweep[0], &holding.sweep[holding.sweep.len() - 1]);
        Chart {
            layers: vec![
                Layer::Limit {
                    at: 1e3 * ACCURATE_WITHIN_M,
                    name: format!("{} mm", 1e3 * ACCURATE_WITHIN_M),
                    colour: "var(--watch)",
                },
                Layer::Mark { at: area(&holding.article), name: format!("{ARTICLE_LPM} L/min") },
                Layer::Mark { at: area(&holding.accurate), name: "1 mm off".into() },
                Layer::Mark { at: area(&holding.in_control), name: "command at its limit".into() },
                Layer::Line { class: "stroke-a", points },
            ],
            key: vec![(
                "how much farther from the demand than without a leak, in the worst hold".into(),
                "var(--a)",
                false,
            )],
            ..Chart::new(
                "Error at the holds' ends by leak area",
                Axis::logarithmic("leak area, mm²", area(first), area(last)),
                Axis::logarithmic("mm", 0.1, 500.0),
            )
        }
        .render()
    }

    fn holding_table(&self) -> Markup {
        let holding = &self.study.holding;
        let rows = [
            ("the article's 0.6 L/min", &holding.article),
            ("holds within 1 mm", &holding.accurate),
            ("command within its range", &holding.in_control),
        ];
        html! { div.scroll { table {
            thead { tr { th { "Up to" } th.number { "area, mm²" } th.number { "L/min at " (bar(REFERENCE_DP_PA)) " bar" } th.number { "L/min in the holds" }
                th.number { "added error, mm" } th.number { "largest command" } } }
            tbody { @for (name, hold) in rows { tr {
                td { (name) }
                td.number { (mm2(hold.leak_area_m2)) }
                td.number { (format!("{:.2}", hold.orifice_lpm)) }
                td.number { (format!("{:.2}", hold.flow_lpm)) }
                td.number { (format!("{:.2}", 1e3 * hold.added_error_m)) }
                td.number { (format!("{:.3}", hold.largest_command)) }
            } } }
        } } }
    }
}

/// Differences of the other levels from the first, % of the first one's range.
fn changes(levels: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let first = &levels[0];
    let low = first.iter().copied().fold(f64::INFINITY, f64::min);
    let high = first.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let change = |values: &Vec<f64>| {
        values.iter().zip(first).map(|(value, first)| 100.0 * (value - first) / (high - low)).collect()
    };
    levels.iter().skip(1).map(change).collect()
}

fn in_mm2(areas_m2: &[f64]) -> Vec<f64> {
    areas_m2.iter().map(|area_m2| area_m2 * MM2_PER_M2).collect()
}

fn shade_colour(index: usize) -> &'static str {
    ["var(--s0)", "var(--s1)", "var(--s2)", "var(--s3)", "var(--s4)", "var(--s5)"][index.min(5)]
}

/// An axis that holds all values with a little room.
fn spanning(values: impl Iterator<Item = f64> + Clone) -> Axis {
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(f64::NEG_INFINITY, f64::max);
    let room = (0.05 * (high - low)).max(1e-9);
    Axis::linear("", low - room, high + room)
}

fn corrections() -> Markup {
    html! { ol {
        li { "Equations (2), (3): the rod chamber's flow is printed as k_v √(2(P₂ − P₁)/ρ); it goes to the return line, P₂ → P_r." }
        li { "Equation (3): printed with −(A_p − A_rod) v_p; the rod chamber is compressed on extension, + (A_p − A_rod) v_p." }
        li { "Equations (1) to (5) describe extension only; retraction follows from the symmetry of the 4/3 valve." }
        li { "The chambers' volumes are printed as one constant; they depend on the position." }
        li { "Equation (1): P_prv, a pressure, stands where the relief valve's flow belongs." }
        li { "The square roots have no sign, and an infinite slope at 0; they are linear below 2 bar here." }
        li { "Equations (3) and (4) give one R_vlv to two paths; they are two parameters here." }
        li { "The text's maximum leakage of 0.6 L/min does not fit areas up to 10 mm²; area and flow at a stated pressure difference are always given together." }
        li { "Q = 0.001 and R = 5 give a steady Kalman gain of 0.014, a low-pass of 70 ms at 1 kHz, which also delays the signal." }
    } }
}
