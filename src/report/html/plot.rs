//! Curves as SVG, in the colors of the page.

use crate::report::html::escaped;

/// Size of a chart and of the margins around its plot, in units of its own.
const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 250.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = 36.0;

/// A curve.
pub(super) struct Series {
    /// Its name, for those who cannot see it.
    pub name: String,
    /// Number of its color.
    pub color: usize,
    /// Its points; those that are not finite are left out.
    pub points: Vec<[f64; 2]>,
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
        let ends = values.map(|value| (value, value));
        let (low, high) = ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))?;
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
    let steps = [1.0, 2.0, 5.0, 10.0].map(|m| m * decade);
    let step = steps.into_iter().find(|step| *step >= rough).unwrap_or(rough);
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

/// The chart of curves over a common axis as an SVG element; empty if no curve has a point. On a
/// `logarithmic` vertical axis, values that are not positive are left out.
pub(super) fn svg(title: &str, across_label: &str, logarithmic: bool, mut series: Vec<Series>) -> String {
    for curve in &mut series {
        curve.points.retain(|p| p.iter().all(|v| v.is_finite()) && (!logarithmic || p[1] > 0.0));
    }
    series.retain(|curve| !curve.points.is_empty());
    let all = |k: usize| series.iter().flat_map(|series| &series.points).map(move |point| point[k]);
    let axes = Axis::around(all(0), false).zip(Axis::around(all(1), logarithmic));
    let Some((across, up)) = axes else { return String::new() };
    let x_of = |value: f64| LEFT + across.place(value) * (WIDTH - LEFT - RIGHT);
    let y_of = |value: f64| TOP + (1.0 - up.place(value)) * (HEIGHT - TOP - BOTTOM);
    let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
    let words = series.iter().map(|Series { name, points, .. }| {
        format!("{name} from {} to {}", short(points[0][1]), short(points[points.len() - 1][1]))
    });
    let in_words = format!("{title} over {across_label}: {}", words.collect::<Vec<_>>().join("; "));
    let mut text = format!(
        "<svg class=\"chart\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\n<text class=\"head\" x=\"{LEFT}\" y=\"17\">{}</text>\n",
        escaped(&in_words),
        escaped(title)
    );
    for mark in &up.marks {
        let y = y_of(*mark);
        text += &format!(
            "<path class=\"grid\" d=\"M{LEFT} {y:.1}H{right}\"/><text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>\n",
            LEFT - 6.0,
            y + 4.0,
            short(*mark)
        );
    }
    for mark in &across.marks {
        let x = x_of(*mark);
        text += &format!(
            "<path class=\"tick\" d=\"M{x:.1} {bottom}v4\"/><text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\n",
            bottom + 17.0,
            short(*mark)
        );
    }
    text += &format!(
        "<path class=\"axis\" d=\"M{LEFT} {bottom}H{right}\"/><text x=\"{right}\" y=\"{:.1}\" text-anchor=\"end\" class=\"unit\">{}</text>\n",
        HEIGHT - 4.0,
        escaped(across_label)
    );
    for Series { name, color, points } in &series {
        let curve = if let [[x, y]] = points.as_slice() {
            format!("<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3\"/>", x_of(*x), y_of(*y))
        } else {
            let points = points.iter().map(|[x, y]| format!("{:.1},{:.1}", x_of(*x), y_of(*y)));
            format!("<polyline points=\"{}\"/>", points.collect::<Vec<_>>().join(" "))
        };
        text += &format!("<g class=\"c{color}\"><title>{}</title>{curve}</g>\n", escaped(name));
    }
    text + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: &[[f64; 2]], logarithmic: bool) -> String {
        let series = Series { name: "a<b".into(), color: 1, points: points.to_vec() };
        svg("loss", "steps", logarithmic, vec![series])
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
