//! Line charts as inline SVG.

use std::fmt::Write;

use maud::{Markup, html};

/// Room for the axes' labels.
const LEFT: f64 = 62.0;
const RIGHT: f64 = 14.0;
/// Room on the right for a second scale.
const SECOND: f64 = 76.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 42.0;
/// Points that are nearer to each other are drawn as one.
const STEP: f64 = 0.25;

/// Width and height of a chart in its own units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Size {
    /// As wide as the page; a phone shows it [narrow](Size::Narrow).
    Wide,
    /// As wide as a phone.
    Narrow,
    /// Half as wide.
    Half,
    /// Three beside each other, without names at the axes.
    Small,
}

impl Size {
    fn width(self) -> f64 {
        match self {
            Size::Wide => 920.0,
            Size::Narrow => 370.0,
            Size::Half => 460.0,
            Size::Small => 300.0,
        }
    }

    fn height(self) -> f64 {
        match self {
            Size::Wide => 300.0,
            Size::Narrow | Size::Half => 270.0,
            Size::Small => 130.0,
        }
    }
}

/// How a value becomes a place on an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scale {
    /// In proportion.
    Linear,
    /// In proportion, without numbers: limits name the values.
    Named,
    /// By its logarithm; values below the lower end are drawn there.
    Logarithmic,
}

/// An axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it shows, with the unit.
    pub label: String,
    /// Lower end.
    pub from: f64,
    /// Upper end.
    pub to: f64,
    /// Scale.
    pub scale: Scale,
}

impl Axis {
    /// A linear axis.
    pub fn linear(label: &str, from: f64, to: f64) -> Self {
        Axis { label: label.into(), from, to, scale: Scale::Linear }
    }

    /// A logarithmic axis; both ends must be positive.
    pub fn logarithmic(label: &str, from: f64, to: f64) -> Self {
        Axis { label: label.into(), from, to, scale: Scale::Logarithmic }
    }

    /// Where a value stands, 0 … 1.
    fn share(&self, value: f64) -> f64 {
        let share = match self.scale {
            Scale::Linear | Scale::Named => (value - self.from) / (self.to - self.from),
            Scale::Logarithmic => (value.max(self.from) / self.from).ln() / (self.to / self.from).ln(),
        };
        if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
    }

    fn ticks(&self) -> Vec<f64> {
        match self.scale {
            Scale::Linear => linear_ticks(self.from, self.to),
            Scale::Named => Vec::new(),
            Scale::Logarithmic => logarithmic_ticks(self.from, self.to),
        }
    }
}

/// Round numbers, five to ten of them.
fn linear_ticks(from: f64, to: f64) -> Vec<f64> {
    let raw = (to - from) / 6.0;
    if !(raw.is_finite() && raw > 0.0) {
        return vec![from];
    }
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|step| *step >= raw).unwrap_or(raw);
    let first = (from / step - 1e-9).ceil() as i64;
    (first..).map(|k| k as f64 * step).take_while(|tick| *tick <= to + 1e-9 * step).take(20).collect()
}

/// Powers of ten, with 3 between them.
fn logarithmic_ticks(from: f64, to: f64) -> Vec<f64> {
    let first = from.log10().floor() as i32;
    let last = to.log10().ceil() as i32;
    (first..=last)
        .flat_map(|power| [1.0, 3.0].map(|m| m * 10f64.powi(power)))
        .filter(|tick| *tick >= from * 0.999 && *tick <= to * 1.001)
        .collect()
}

/// A tick's number without a tail of zeros or rounding; very small and very large ones with their power of ten.
pub(crate) fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    if !(1e-4..1e6).contains(&value.abs()) {
        let text = format!("{value:.2e}");
        let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{power}", digits.trim_end_matches('0').trim_end_matches('.'));
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 9) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// What is drawn.
#[derive(Debug, Clone, PartialEq)]
pub enum Layer {
    /// A line through points; the class gives its colour.
    Line {
        /// CSS classes.
        class: &'static str,
        /// Points.
        points: Vec<(f64, f64)>,
    },
    /// The area between two curves: x, lower, upper.
    Band {
        /// CSS classes.
        class: &'static str,
        /// Points.
        points: Vec<(f64, f64, f64)>,
    },
    /// A horizontal line with a name at its right end.
    Limit {
        /// Place.
        at: f64,
        /// Name.
        name: String,
        /// CSS colour.
        colour: &'static str,
    },
    /// Points.
    Points {
        /// CSS classes.
        class: &'static str,
        /// Places.
        points: Vec<(f64, f64)>,
    },
    /// A vertical line with a name at its foot.
    Mark {
        /// Place.
        at: f64,
        /// Name.
        name: String,
    },
    /// A coloured stretch along the lower edge.
    Stretch {
        /// Start.
        from: f64,
        /// End.
        to: f64,
        /// CSS colour.
        colour: String,
        /// What it says when pointed at.
        name: String,
    },
}

/// A chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Chart {
    /// What it shows, for readers that do not see it.
    pub title: String,
    /// Horizontal axis.
    pub x: Axis,
    /// Vertical axis.
    pub y: Axis,
    /// A second scale on the right: what it shows, and its value for 1 on the left.
    pub right: Option<(String, f64)>,
    /// Size.
    pub size: Size,
    /// From back to front.
    pub layers: Vec<Layer>,
    /// Names of the layers: text, CSS colour, whether it is an area.
    pub key: Vec<(String, &'static str, bool)>,
}

impl Chart {
    /// An empty chart of that title.
    pub fn new(title: &str, x: Axis, y: Axis) -> Self {
        let (layers, key) = (Vec::new(), Vec::new());
        Chart { title: title.into(), x, y, right: None, size: Size::Wide, layers, key }
    }

    fn end(&self) -> f64 {
        self.size.width() - if self.right.is_some() { SECOND } else { RIGHT }
    }

    fn foot(&self) -> f64 {
        self.size.height() - if self.size == Size::Small { 22.0 } else { BOTTOM }
    }

    fn px(&self, x: f64) -> f64 {
        LEFT + self.x.share(x) * (self.end() - LEFT)
    }

    fn py(&self, y: f64) -> f64 {
        self.foot() - self.y.share(y) * (self.foot() - TOP)
    }

    /// The chart as a figure.
    pub fn render(&self) -> Markup {
        html! {
            figure {
                @if self.size == Size::Wide {
                    (self.drawing("wide"))
                    (Chart { size: Size::Narrow, ..self.clone() }.drawing("narrow"))
                } @else {
                    figcaption { (self.title) }
                    (self.drawing("part"))
                }
                @if !self.key.is_empty() {
                    div.key {
                        @for (name, colour, area) in &self.key {
                            span.wide[*area] style=(format!("--c:{colour}")) { (name) }
                        }
                    }
                }
            }
        }
    }

    /// The drawing alone, of a class that tells where it is shown.
    fn drawing(&self, class: &str) -> Markup {
        let (width, height) = (self.size.width(), self.size.height());
        html! {
            svg class=(class) viewBox=(format!("0 0 {width} {height}")) role="img" aria-label=(self.title) {
                (self.axes())
                @if let Some((label, factor)) = &self.right { (self.second_scale(label, *factor)) }
                @for layer in &self.layers { (self.layer(layer)) }
            }
        }
    }

    fn axes(&self) -> Markup {
        let (foot, end) = (self.foot(), self.end());
        html! {
            @for tick in self.y.ticks() {
                @let y = self.py(tick);
                line.grid x1=(LEFT) x2=(end) y1=(round(y)) y2=(round(y)) {}
                text x=(LEFT - 8.0) y=(round(y + 4.0)) text-anchor="end" { (number(tick)) }
            }
            @for tick in self.x.ticks() {
                @let x = self.px(tick);
                line.axis x1=(round(x)) x2=(round(x)) y1=(foot) y2=(foot + 5.0) {}
                text x=(round(x)) y=(foot + 18.0) text-anchor="middle" { (number(tick)) }
            }
            line.axis x1=(LEFT) x2=(end) y1=(foot) y2=(foot) {}
            @if self.size != Size::Small {
                text x=(0.5 * (LEFT + end)) y=(self.size.height() - 6.0) text-anchor="middle" { (self.x.label) }
                text x="14" y=(0.5 * (TOP + foot)) text-anchor="middle"
                    transform=(format!("rotate(-90 14 {})", 0.5 * (TOP + foot))) { (self.y.label) }
            }
        }
    }

    fn second_scale(&self, label: &str, factor: f64) -> Markup {
        let (middle, x) = (0.5 * (TOP + self.foot()), self.size.width() - 14.0);
        let scaled = Axis { from: self.y.from * factor, to: self.y.to * factor, ..self.y.clone() };
        html! {
            @for tick in scaled.ticks() {
                @let y = round(self.py(tick / factor));
                line.axis x1=(self.end()) x2=(self.end() + 5.0) y1=(y) y2=(y) {}
                text x=(self.end() + 9.0) y=(round(y + 4.0)) { (number(tick)) }
            }
            text x=(x) y=(middle) text-anchor="middle" transform=(format!("rotate(90 {x} {middle})")) { (label) }
        }
    }

    fn layer(&self, layer: &Layer) -> Markup {
        match layer {
            Layer::Line { class, points } => html! {
                path class=(format!("series {class}")) d=(self.path(points.iter().copied(), 'M')) {}
            },
            Layer::Band { class, points } => {
                let mut d = self.path(points.iter().map(|(x, _, high)| (*x, *high)), 'M');
                d += &self.path(points.iter().rev().map(|(x, low, _)| (*x, *low)), 'L');
                html! { path class=(class) d=(d + "Z") {} }
            }
            Layer::Points { class, points } => html! {
                @for (x, y) in points {
                    circle class=(class) cx=(round(self.px(*x))) cy=(round(self.py(*y))) r="2.2" {}
                }
            },
            Layer::Limit { at, name, colour } => {
                let y = round(self.py(*at));
                html! {
                    line.limit x1=(LEFT) x2=(self.end()) y1=(y) y2=(y) style=(format!("stroke:{colour}")) {}
                    text x=(LEFT + 6.0) y=(y - 4.0) style=(format!("fill:{colour}")) { (name) }
                }
            }
            Layer::Mark { at, name } => {
                let x = round(self.px(*at));
                html! {
                    line.mark x1=(x) x2=(x) y1=(TOP) y2=(self.foot()) {}
                    text x=(x + 4.0) y=(TOP + 10.0) { (name) }
                }
            }
            Layer::Stretch { from, to, colour, name } => {
                let (from, to) = (round(self.px(*from)), round(self.px(*to)));
                html! {
                    rect x=(from) width=((to - from).max(0.5)) y=(self.foot() - 9.0) height="9"
                        style=(format!("fill:{colour}")) { title { (name) } }
                }
            }
        }
    }

    fn path(&self, points: impl Iterator<Item = (f64, f64)>, first: char) -> String {
        let (mut d, mut last) = (String::new(), None);
        for (x, y) in points {
            let (x, y) = (self.px(x), self.py(y));
            // Steps that nobody sees are left out.
            if last.is_some_and(|(a, b): (f64, f64)| (x - a).abs() < STEP && (y - b).abs() < STEP) {
                continue;
            }
            let command = if last.is_none() { first } else { 'L' };
            // Writing to a String does not fail.
            let _ = write!(d, "{command}{x:.1} {y:.1}");
            last = Some((x, y));
        }
        d
    }
}

fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers() {
        assert_eq!(linear_ticks(0.0, 10.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        let names: Vec<String> = linear_ticks(-0.3, 0.3).into_iter().map(number).collect();
        assert_eq!(names, ["-0.3", "-0.2", "-0.1", "0", "0.1", "0.2", "0.3"]);
        let names: Vec<String> = logarithmic_ticks(0.01, 10.0).into_iter().map(number).collect();
        assert_eq!(names, ["0.01", "0.03", "0.1", "0.3", "1", "3", "10"]);
        assert_eq!([1e-8, 3e-8, -2.5e-5, 2e7].map(number), ["1e-8", "3e-8", "-2.5e-5", "2e7"]);
    }

    #[test]
    fn a_line_runs_from_corner_to_corner() {
        let chart = Chart::new("t", Axis::linear("x", 0.0, 1.0), Axis::logarithmic("y", 1.0, 100.0));
        let d = chart.path([(0.0, 1.0), (0.5, 10.0), (1.0, 1e9)].into_iter(), 'M');
        assert_eq!(d, "M62.0 258.0L484.0 135.0L906.0 12.0");
    }
}
