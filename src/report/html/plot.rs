//! Curves as SVG, in the colors of the page.

use crate::report::html::text::escaped;
use std::fmt::Write as _;

/// Size of a chart and of the margins around its plot, in units of its own.
const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 250.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 36.0;

/// A curve.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// Its name, for those who cannot see it.
    pub name: String,
    /// Number of its color.
    pub color: usize,
    /// Its points; those that are not finite are left out.
    pub points: Vec<[f64; 2]>,
}

/// A plot of curves over a common axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot {
    /// Its title, with the unit.
    pub title: String,
    /// The horizontal axis, with its unit.
    pub across: String,
    /// Whether the vertical axis is logarithmic; values that are not positive are left out then.
    pub logarithmic: bool,
    /// The curves.
    pub series: Vec<Series>,
}

/// An axis: its ends in plotted values, and the values that are marked.
struct Axis {
    low: f64,
    high: f64,
    logarithmic: bool,
    marks: Vec<f64>,
}

impl Axis {
    /// An axis with all `values`; `None` without any.
    fn around(values: impl Iterator<Item = f64>, logarithmic: bool) -> Option<Self> {
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            return None;
        }
        let (low, high) = match (logarithmic, low < high) {
            (_, true) => (low, high),
            (true, false) => (low / 2.0, high * 2.0),
            (false, false) => (low - low.abs().max(1.0) * 0.1, high + high.abs().max(1.0) * 0.1),
        };
        let decades = if logarithmic { decades(low, high) } else { Vec::new() };
        let marks = if decades.len() >= 3 { decades } else { round_steps(low, high) };
        Some(Self { low, high, logarithmic, marks })
    }

    /// The place of a value: 0 at the low end, 1 at the high one.
    fn place(&self, value: f64) -> f64 {
        let at = |v: f64| if self.logarithmic { v.log10() } else { v };
        (at(value) - at(self.low)) / (at(self.high) - at(self.low))
    }
}

/// Round values from `low` to `high`, four to nine of them.
fn round_steps(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step =
        [1.0, 2.0, 5.0, 10.0].map(|m| m * decade).into_iter().find(|step| *step >= rough).unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    (first..first + 12).map(|i| i as f64 * step).take_while(|v| *v <= high + step * 1e-6).collect()
}

/// Powers of ten from `low` to `high`, and their doubles and halves if there are few.
fn decades(low: f64, high: f64) -> Vec<f64> {
    let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
    let factors: &[f64] = if last - first > 3 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let all = (first..=last).flat_map(|power| factors.iter().map(move |factor| factor * 10f64.powi(power)));
    all.filter(|v| (low * 0.999..=high * 1.001).contains(v)).collect()
}

/// A value in few characters.
fn short(value: f64) -> String {
    match value.abs() {
        size if size >= 1e6 || (size > 0.0 && size < 1e-3) => format!("{value:.0e}"),
        _ => format!("{}", (value * 1e6).round() / 1e6),
    }
}

/// The chart as an SVG element; empty if no curve has a point.
pub fn svg(chart: &Plot) -> String {
    let series: Vec<Series> = chart.series.iter().map(|series| plotted(series, chart.logarithmic)).collect();
    let points = || series.iter().flat_map(|series| &series.points);
    let Some(across) = Axis::around(points().map(|p| p[0]), false) else { return String::new() };
    let Some(up) = Axis::around(points().map(|p| p[1]), chart.logarithmic) else { return String::new() };
    let label = escaped(&summary(chart, &series));
    let mut text = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{label}\">\n<text class=\"head\" x=\"{LEFT}\" y=\"17\">{}</text>\n",
        escaped(&chart.title)
    );
    draw_axes(&mut text, &across, &up, &chart.across);
    for series in series.iter().filter(|series| !series.points.is_empty()) {
        draw_curve(&mut text, series, &across, &up);
    }
    text + "</svg>\n"
}

/// The points of a curve that can be plotted.
fn plotted(series: &Series, logarithmic: bool) -> Series {
    let can = |p: &&[f64; 2]| p.iter().all(|v| v.is_finite()) && (!logarithmic || p[1] > 0.0);
    Series { points: series.points.iter().filter(can).copied().collect(), ..series.clone() }
}

/// The chart in words.
fn summary(chart: &Plot, series: &[Series]) -> String {
    let words = series.iter().filter_map(|series| {
        let (first, last) = (series.points.first()?, series.points.last()?);
        Some(format!("{} from {} to {}", series.name, short(first[1]), short(last[1])))
    });
    format!("{} over {}: {}", chart.title, chart.across, words.collect::<Vec<_>>().join("; "))
}

fn left_of(axis: &Axis, value: f64) -> f64 {
    LEFT + axis.place(value) * (WIDTH - LEFT - RIGHT)
}

fn top_of(axis: &Axis, value: f64) -> f64 {
    TOP + (1.0 - axis.place(value)) * (HEIGHT - TOP - BOTTOM)
}

fn draw_axes(text: &mut String, across: &Axis, up: &Axis, label: &str) {
    let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
    // Writing to a String cannot fail.
    for mark in &up.marks {
        let y = top_of(up, *mark);
        let _ = writeln!(
            text,
            "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 6.0,
            y + 4.0,
            short(*mark)
        );
    }
    for mark in &across.marks {
        let x = left_of(across, *mark);
        let _ = writeln!(
            text,
            "<path class=\"tick\" d=\"M{x:.1} {bottom}v4\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
            bottom + 17.0,
            short(*mark)
        );
    }
    let _ = writeln!(
        text,
        "<path class=\"axis\" d=\"M{LEFT} {bottom}H{right}\"/><text x=\"{right}\" y=\"{:.1}\" text-anchor=\"end\" class=\"unit\">{}</text>",
        HEIGHT - 4.0,
        escaped(label)
    );
}

fn draw_curve(text: &mut String, series: &Series, across: &Axis, up: &Axis) {
    let at = |p: &[f64; 2]| (left_of(across, p[0]), top_of(up, p[1]));
    let _ = write!(text, "<g class=\"c{}\"><title>{}</title>", series.color, escaped(&series.name));
    if let [only] = series.points.as_slice() {
        let (x, y) = at(only);
        let _ = write!(text, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\"/>");
    } else {
        let points: Vec<String> =
            series.points.iter().map(at).map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
        let _ = write!(text, "<polyline points=\"{}\"/>", points.join(" "));
    }
    *text += "</g>\n";
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: &[[f64; 2]], logarithmic: bool) -> String {
        let series = vec![Series { name: "a<b".into(), color: 1, points: points.to_vec() }];
        svg(&Plot { title: "loss".into(), across: "steps".into(), logarithmic, series })
    }

    #[test]
    fn points_stand_where_the_axes_say() {
        let text = chart(&[[0.0, 1.0], [100.0, 3.0]], false);
        assert!(text.contains("points=\"58.0,214.0 466.0,30.0\""), "{text}");
        assert!(text.contains("a&lt;b from 1 to 3") && !text.contains("a<b"), "{text}");
        for mark in [">20<", ">100<", ">1.5<", ">3<"] {
            assert!(text.contains(mark), "no {mark} in {text}");
        }
        let text = chart(&[[0.0, 0.01], [50.0, 0.1], [100.0, 1.0]], true);
        assert!(text.contains("262.0,122.0"), "the middle of two decades: {text}");
    }

    #[test]
    fn nothing_that_cannot_be_plotted_is() {
        assert_eq!(chart(&[], false), "");
        assert_eq!(chart(&[[f64::NAN, 1.0], [1.0, f64::INFINITY]], false), "");
        assert_eq!(chart(&[[1.0, 0.0], [2.0, -1.0]], true), "");
        for (points, logarithmic) in
            [([[1.0, 5.0]; 1], false), ([[1.0, 0.02]; 1], true), ([[0.0, 0.0]; 1], false)]
        {
            let text = chart(&points, logarithmic);
            assert!(text.contains("<circle") && !text.contains("NaN") && !text.contains("inf"), "{text}");
        }
        // Within less than a decade there are no three of its marks.
        let text = chart(&[[0.0, 0.006], [1.0, 0.009]], true);
        assert!(text.contains(">0.007<") && text.contains(">0.009<"), "{text}");
        let text = chart(&[[0.0, 1e-12], [1e9, 1e12]], true);
        assert!(!text.contains("NaN") && text.len() < 6000, "{text}");
    }

    #[test]
    fn marks_are_round_and_few() {
        assert_eq!(round_steps(0.0, 500.0), [0.0, 100.0, 200.0, 300.0, 400.0, 500.0]);
        assert_eq!(decades(0.03, 4.0), [0.05, 0.1, 0.2, 0.5, 1.0, 2.0]);
        assert_eq!(decades(1e-6, 1.0).len(), 7);
        assert_eq!([short(0.1 + 0.2), short(2e7), short(-0.00002)], ["0.3", "2e7", "-2e-5"]);
    }
}
