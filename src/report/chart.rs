//! Line charts as SVG, for paper and screen.

use std::fmt::Write;

use super::ticks::{self, Tick};
use super::wording::escape;

/// The size of a drawing in units of its text, of which a digit is about 7 wide.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Size {
    class: &'static str,
    width: f64,
    height: f64,
    /// Number of ticks on axes of time, of numbers, and on the vertical one.
    ticks: [usize; 3],
}

/// For paper and wide screens.
const WIDE: Size = Size { class: "wide", width: 760.0, height: 250.0, ticks: [6, 8, 5] };

/// For a phone, where the wide one would have unreadable text.
const NARROW: Size = Size { class: "narrow", width: 360.0, height: 230.0, ticks: [3, 4, 5] };

/// Room for the title and for labels of eight characters.
const LEFT: f64 = 80.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 46.0;

/// Half the width of the longest time label.
const LABEL_HALF: f64 = 36.0;

/// Half the width of the band of a record between gaps.
const LONE_HALF: f64 = 2.0;

/// The time shown before and after a single record, in seconds.
const LONE_ROOM_S: f64 = 300.0;

/// The least vertical range as a fraction of the greatest value: the labels of a narrower one have more
/// digits than fit beside the axis.
const FLAT: f64 = 1e-3;

/// The scale of the horizontal axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum XAxis {
    /// Seconds since 1970, labelled as times in UTC.
    Time,
    /// Numbers.
    Number,
}

/// One curve: points in the order of x, with gaps for missing values.
#[derive(Debug)]
pub(super) struct Series {
    pub(super) name: String,
    pub(super) points: Vec<(f64, Option<f64>)>,
    /// CSS class.
    pub(super) class: &'static str,
}

/// A horizontal reference line.
#[derive(Debug)]
pub(super) struct Level {
    pub(super) name: String,
    pub(super) y: f64,
    pub(super) class: &'static str,
}

/// A vertical mark of an event.
#[derive(Debug)]
pub(super) struct Mark {
    pub(super) x: f64,
    pub(super) class: &'static str,
    pub(super) name: String,
}

/// A chart with curves, a band, levels and marks.
#[derive(Debug)]
pub(super) struct Chart {
    pub(super) horizontal: XAxis,
    pub(super) x_title: String,
    pub(super) y_title: String,
    pub(super) series: Vec<Series>,
    /// Each x with the lower and the upper edge, with gaps for missing ones.
    pub(super) band: Vec<(f64, Option<[f64; 2]>)>,
    pub(super) levels: Vec<Level>,
    /// Drawn if they are within the range of the curves.
    pub(super) marks: Vec<Mark>,
    /// Whether the vertical axis starts at 0.
    pub(super) from_zero: bool,
}

/// The ranges of the plot area.
struct Frame {
    size: Size,
    x: [f64; 2],
    y: [f64; 2],
}

impl Frame {
    fn x_px(&self, x: f64) -> f64 {
        LEFT + (x - self.x[0]) / (self.x[1] - self.x[0]) * (self.size.width - LEFT - RIGHT)
    }

    fn y_px(&self, y: f64) -> f64 {
        let height = self.size.height;
        height - BOTTOM - (y - self.y[0]) / (self.y[1] - self.y[0]) * (height - TOP - BOTTOM)
    }
}

impl Chart {
    /// Whether there is anything to draw.
    pub(super) fn is_empty(&self) -> bool {
        self.series.iter().all(|series| series.points.iter().all(|(_, y)| y.is_none()))
    }

    /// Renders the chart as SVG in a wide and a narrow form, of which the page shows the one that fits;
    /// `label` describes it for screen readers.
    pub(super) fn svg(&self, label: &str) -> String {
        [WIDE, NARROW].map(|size| self.drawn(size, label)).concat()
    }

    fn drawn(&self, size: Size, label: &str) -> String {
        let frame = self.frame(size);
        let Size { class, width, height, .. } = size;
        let mut svg = format!(
            "<svg class=\"{class}\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\">",
            escape(label)
        );
        self.axes(&frame, &mut svg);
        for stretch in self.band.split(|(_, edges)| edges.is_none()).filter(|stretch| !stretch.is_empty()) {
            // The polygon of a lone record has no area without its half width.
            let half = if stretch.len() == 1 { LONE_HALF } else { 0.0 };
            let edges = stretch.iter().filter_map(|(x, edges)| Some((frame.x_px(*x), (*edges)?)));
            let upper = edges.clone().flat_map(|(x, [_, high])| [(x - half, high), (x + half, high)]);
            let lower = edges.rev().flat_map(|(x, [low, _])| [(x + half, low), (x - half, low)]);
            let outline = upper.chain(lower).map(|(x, y)| format!("{x:.1},{:.1} ", frame.y_px(y)));
            let outline: String = outline.collect();
            let _ = write!(svg, "<polygon class=\"band\" points=\"{}\"/>", outline.trim_end());
        }
        for level in &self.levels {
            let y = frame.y_px(level.y);
            let _ = write!(
                svg,
                "<line class=\"{0}\" x1=\"{LEFT}\" x2=\"{1}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/><text class=\"{0}\" x=\"{2}\" y=\"{3:.1}\">{4}</text>",
                level.class,
                width - RIGHT,
                LEFT + 4.0,
                y - 4.0,
                escape(&level.name)
            );
        }
        let within = |mark: &&Mark| frame.x[0] <= mark.x && mark.x <= frame.x[1];
        for mark in self.marks.iter().filter(within) {
            let x = frame.x_px(mark.x);
            let _ = write!(
                svg,
                "<line class=\"mark {}\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{TOP}\" y2=\"{}\"><title>{}</title></line>",
                mark.class,
                height - BOTTOM,
                escape(&mark.name)
            );
        }
        for series in &self.series {
            for stretch in series.points.split(|(_, y)| y.is_none()).filter(|stretch| !stretch.is_empty()) {
                let reduced = downsample(stretch, &frame);
                let points: String = reduced.iter().map(|(x, y)| point(&frame, *x, *y)).collect();
                // A line from a lone point to itself is drawn as a dot.
                let (lone, points) =
                    if reduced.len() == 1 { (" lone", points.repeat(2)) } else { ("", points) };
                let points = points.trim_end();
                let _ = write!(svg, "<polyline class=\"{}{lone}\" points=\"{points}\"/>", series.class);
            }
        }
        svg + "</svg>"
    }

    /// Renders the legend of curves, band and marks, to be placed below the chart.
    pub(super) fn legend(&self, band: Option<&str>) -> String {
        let band =
            band.filter(|_| self.band.iter().any(|(_, edges)| edges.is_some())).map(|name| ("band", name));
        let names = self.series.iter().map(|series| (series.class, series.name.as_str())).chain(band);
        let mut entries: String = names.map(|(class, name)| entry(class, name)).collect();
        for (class, words) in
            [("warning", "warning raised"), ("danger", "danger raised"), ("maintenance", "maintenance")]
        {
            if self.marks.iter().any(|mark| mark.class == class) {
                entries += &entry(&format!("mark {class}"), words);
            }
        }
        format!("<ul class=\"legend\">{entries}</ul>")
    }

    fn frame(&self, size: Size) -> Frame {
        let xs = self.series.iter().flat_map(|series| series.points.iter().map(|(x, _)| *x));
        let ys = self.series.iter().flat_map(|series| series.points.iter().filter_map(|(_, y)| *y));
        let ys = ys
            .chain(self.band.iter().filter_map(|(_, edges)| *edges).flatten())
            .chain(self.levels.iter().map(|level| level.y));
        let half = |y: f64| if y == 0.0 { 0.5 } else { 0.5 * y.abs() };
        let [mut low, mut high] = extent(ys, half);
        let missing = FLAT * low.abs().max(high.abs()) - (high - low);
        if missing > 0.0 {
            (low, high) = (low - 0.5 * missing, high + 0.5 * missing);
        }
        if self.from_zero {
            low = low.min(0.0);
        }
        let margin = 0.06 * (high - low);
        let below = if self.from_zero && low == 0.0 { 0.0 } else { margin };
        let x = match self.horizontal {
            XAxis::Time => extent(xs, |_| LONE_ROOM_S),
            XAxis::Number => extent(xs, half),
        };
        Frame { size, x, y: [low - below, high + margin] }
    }

    fn axes(&self, frame: &Frame, svg: &mut String) {
        let Size { width, height, ticks: [times, numbers, upwards], .. } = frame.size;
        let (right, bottom) = (width - RIGHT, height - BOTTOM);
        for Tick { at, label } in ticks::numbers(frame.y[0], frame.y[1], upwards) {
            let y = frame.y_px(at);
            let _ = write!(
                svg,
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{right}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/><text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{label}</text>",
                LEFT - 6.0,
                y + 4.0
            );
        }
        let across = match self.horizontal {
            XAxis::Time => ticks::times(frame.x[0], frame.x[1], times),
            XAxis::Number => ticks::numbers(frame.x[0], frame.x[1], numbers),
        };
        for Tick { at, label } in across {
            let x = frame.x_px(at);
            // A label centred on the last tick would exceed the edge of the chart.
            let anchor = if x + LABEL_HALF > width { "end" } else { "middle" };
            let _ = write!(
                svg,
                "<line class=\"tick\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"{bottom}\" y2=\"{}\"/><text x=\"{x:.1}\" y=\"{}\" text-anchor=\"{anchor}\">{label}</text>",
                bottom + 5.0,
                bottom + 18.0
            );
        }
        let _ = write!(
            svg,
            "<line class=\"axis\" x1=\"{LEFT}\" x2=\"{right}\" y1=\"{bottom}\" y2=\"{bottom}\"/>\
             <text class=\"title\" x=\"{}\" y=\"{}\" text-anchor=\"middle\">{}</text>\
             <text class=\"title\" transform=\"translate(14 {}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            (LEFT + right) / 2.0,
            height - 8.0,
            escape(&self.x_title),
            (TOP + bottom) / 2.0,
            escape(&self.y_title)
        );
    }
}

fn entry(class: &str, name: &str) -> String {
    let swatch = if class == "band" {
        "<rect class=\"band\" width=\"24\" height=\"12\"/>".to_owned()
    } else if class.starts_with("mark") {
        format!("<line class=\"{class}\" x1=\"12\" x2=\"12\" y1=\"0\" y2=\"12\"/>")
    } else {
        format!("<polyline class=\"{class}\" points=\"0,6 24,6\"/>")
    };
    format!(
        "<li><svg class=\"swatch\" viewBox=\"0 0 24 12\" width=\"24\" height=\"12\" aria-hidden=\"true\">{swatch}</svg> {}</li>",
        escape(name)
    )
}

fn point(frame: &Frame, x: f64, y: f64) -> String {
    format!("{:.1},{:.1} ", frame.x_px(x), frame.y_px(y))
}

/// The minimum and the maximum; around a single value, `room` to both sides.
fn extent(values: impl Iterator<Item = f64>, room: impl Fn(f64) -> f64) -> [f64; 2] {
    let [low, high] = values
        .filter(|value| value.is_finite())
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)]);
    if low > high {
        [0.0, 1.0]
    } else if low == high {
        [low - room(low), high + room(high)]
    } else {
        [low, high]
    }
}

/// Reduces points to the lowest and the highest in each half unit of width, in the order of x: more would not
/// be visible.
fn downsample(stretch: &[(f64, Option<f64>)], frame: &Frame) -> Vec<(f64, f64)> {
    let column = |x: f64| (2.0 * frame.x_px(x)).floor() as i64;
    let mut reduced = Vec::new();
    for points in stretch.chunk_by(|a, b| column(a.0) == column(b.0)) {
        let valued = points.iter().filter_map(|(x, y)| Some((*x, (*y)?)));
        let by_height = |a: &(f64, f64), b: &(f64, f64)| a.1.total_cmp(&b.1);
        let (least, greatest) = (valued.clone().min_by(by_height), valued.max_by(by_height));
        let (Some(least), Some(greatest)) = (least, greatest) else {
            continue;
        };
        reduced.push(if least.0 <= greatest.0 { least } else { greatest });
        if least != greatest {
            reduced.push(if least.0 <= greatest.0 { greatest } else { least });
        }
    }
    reduced
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(points: Vec<(f64, Option<f64>)>) -> Chart {
        Chart {
            horizontal: XAxis::Number,
            x_title: "x".to_owned(),
            y_title: "y".to_owned(),
            series: vec![Series { name: "a < b".to_owned(), points, class: "one" }],
            band: Vec::new(),
            levels: Vec::new(),
            marks: Vec::new(),
            from_zero: true,
        }
    }

    #[test]
    fn a_gap_breaks_the_curve() {
        let svg =
            chart(vec![(0.0, Some(1.0)), (1.0, Some(2.0)), (2.0, None), (3.0, Some(1.0)), (4.0, Some(0.5))])
                .svg("words");
        assert_eq!(svg.matches("<polyline").count(), 2 * 2, "in the wide and in the narrow drawing");
    }

    #[test]
    fn a_lone_record_is_drawn_around_its_time() {
        let start = 1_772_352_000.0;
        let mut lone = chart(vec![(start, Some(0.0007))]);
        (lone.horizontal, lone.from_zero) = (XAxis::Time, false);
        lone.band = vec![(start, Some([0.0006, 0.0008]))];
        let svg = lone.drawn(WIDE, "words");
        assert!(svg.contains("03-01 08:00"), "{svg}");
        assert!(svg.contains("<polyline class=\"one lone\" points=\"414.0,"), "{svg}");
        assert!(svg.contains("<polygon class=\"band\" points=\"412.0,"), "{svg}");
        let frame = lone.frame(WIDE);
        assert_eq!(frame.x, [start - 300.0, start + 300.0]);
        lone.band.clear();
        let [low, high] = lone.frame(WIDE).y;
        assert!(0.0 < low && high < 0.002, "{low} to {high}");
    }

    #[test]
    fn the_labels_of_almost_equal_values_are_short() {
        for value in [1.600_937_4, 0.001_234_56, 98_765.4] {
            let mut chart =
                chart((0..5).map(|n| (f64::from(n), Some(value + 1e-9 * f64::from(n)))).collect());
            chart.from_zero = false;
            let [low, high] = chart.frame(WIDE).y;
            let ticks = ticks::numbers(low, high, 5);
            assert!(ticks.len() >= 2 && ticks.iter().all(|tick| tick.label.len() <= 9), "{ticks:?}");
        }
    }

    #[test]
    fn a_gap_breaks_the_band() {
        let mut chart = chart((0..5).map(|n| (f64::from(n), Some(1.0))).collect());
        chart.band = [true, true, false, true, true]
            .iter()
            .zip(0..)
            .map(|(is, n)| (f64::from(n), is.then_some([0.5, 1.5])))
            .collect();
        assert_eq!(chart.drawn(WIDE, "words").matches("<polygon").count(), 2);
    }

    #[test]
    fn a_spike_among_many_points_is_drawn() {
        let mut points: Vec<_> = (0..100_000).map(|n| (f64::from(n), Some(0.0))).collect();
        points[54_321].1 = Some(7.0);
        let chart = chart(points);
        let frame = chart.frame(WIDE);
        let reduced = downsample(&chart.series[0].points, &frame);
        assert!(reduced.len() < 4000 && reduced.contains(&(54_321.0, 7.0)), "{}", reduced.len());
    }

    #[test]
    fn names_are_escaped() {
        assert!(chart(Vec::new()).legend(None).contains("a &lt; b"));
    }
}
