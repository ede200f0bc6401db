//! One diagram of a figure.

use plotly::common::{Anchor, DashType, Line, Marker, MarkerSymbol, Mode, Orientation, Title};
use plotly::layout::{Axis, Legend, Margin, Shape, ShapeLayer, ShapeLine, ShapeType};
use plotly::{Configuration, Layout, Plot, Scatter};

/// Colours of no wear and of the three wear degrees: safe for colour blindness, darker with more wear.
pub(super) const COLOURS: [&str; 4] = ["#7f7f7f", "#56b4e9", "#0072b2", "#d55e00"];

/// A diagram under construction.
pub(super) struct Panel {
    plot: Plot,
    layout: Layout,
}

impl Panel {
    pub(super) fn new(title: &str, x: &str, y: &str) -> Self {
        let axis = |name: &str| Axis::new().title(Title::with_text(name)).auto_margin(true).zero_line(false);
        Self {
            plot: Plot::new(),
            layout: Layout::new()
                .title(Title::with_text(title))
                .height(if title.is_empty() { 330 } else { 360 })
                .auto_size(true)
                .margin(
                    Margin::new().left(70).right(15).top(if title.is_empty() { 35 } else { 65 }).bottom(50),
                )
                // Above the diagram, where it covers no curve.
                .legend(
                    Legend::new().orientation(Orientation::Horizontal).x(0.0).y(1.0).y_anchor(Anchor::Bottom),
                )
                .x_axis(axis(x))
                .y_axis(axis(y)),
        }
    }

    /// Adds a line; without a name it has no legend entry.
    pub(super) fn line(mut self, name: &str, colour: &str, x: Vec<f64>, y: Vec<f64>) -> Self {
        let line = Line::new().color(colour.to_owned()).width(1.6);
        let trace = Scatter::new(x, y).mode(Mode::Lines).line(line).name(name).show_legend(!name.is_empty());
        self.plot.add_trace(trace);
        self
    }

    /// Adds points; without a name they have no legend entry.
    pub(super) fn points(mut self, name: &str, colour: &str, x: Vec<f64>, y: Vec<f64>) -> Self {
        let marker = Marker::new().color(colour.to_owned()).size(5).symbol(MarkerSymbol::CircleOpen);
        let trace =
            Scatter::new(x, y).mode(Mode::Markers).marker(marker).name(name).show_legend(!name.is_empty());
        self.plot.add_trace(trace);
        self
    }

    /// Adds a dashed horizontal line at `y`.
    pub(super) fn level(mut self, name: &str, y: f64, [from, to]: [f64; 2]) -> Self {
        let line = Line::new().color("#000000").width(1.0).dash(DashType::Dash);
        let trace = Scatter::new(vec![from, to], vec![y, y]).mode(Mode::Lines).line(line).name(name);
        self.plot.add_trace(trace);
        self
    }

    /// Adds a thin dotted vertical line at `x`.
    pub(super) fn mark(mut self, x: f64) -> Self {
        self.layout.add_shape(
            Shape::new()
                .shape_type(ShapeType::Line)
                .layer(ShapeLayer::Below)
                .x_ref("x")
                .y_ref("paper")
                .x0(x)
                .x1(x)
                .y0(0.0)
                .y1(1.0)
                .line(ShapeLine::new().color("#999999").width(1.0).dash(DashType::Dot)),
        );
        self
    }

    /// Sets the title and the limits of the y axis.
    pub(super) fn y_range(mut self, title: &str, low: f64, high: f64) -> Self {
        let axis = Axis::new()
            .title(Title::with_text(title))
            .auto_margin(true)
            .zero_line(false)
            .range(vec![low, high]);
        self.layout = self.layout.y_axis(axis);
        self
    }

    pub(super) fn html(self) -> String {
        let mut plot = self.plot;
        plot.set_layout(self.layout);
        plot.set_configuration(Configuration::new().responsive(true).display_logo(false));
        format!("<div class=\"panel\">{}</div>", plot.to_inline_html(None))
    }
}
