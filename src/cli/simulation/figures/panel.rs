//! One diagram of a figure.

use serde_json::{Value, json};

use crate::cli::simulation::plot;

/// Colours of no wear and of the three wear degrees: safe for colour blindness, darker with more wear.
pub(super) const COLOURS: [&str; 4] = ["#7f7f7f", "#56b4e9", "#0072b2", "#d55e00"];

/// A diagram under construction.
pub(super) struct Panel {
    traces: Vec<Value>,
    /// Vertical lines.
    shapes: Vec<Value>,
    layout: Value,
}

impl Panel {
    pub(super) fn new(title: &str, x: &str, y: &str) -> Self {
        let (height, top) = if title.is_empty() { (330, 35) } else { (360, 65) };
        Self {
            traces: Vec::new(),
            shapes: Vec::new(),
            layout: json!({
                "title": { "text": title },
                "height": height,
                "autosize": true,
                "margin": { "l": 70, "r": 15, "t": top, "b": 50 },
                // Above the diagram, where it covers no curve.
                "legend": { "orientation": "h", "x": 0, "y": 1, "yanchor": "bottom" },
                "xaxis": axis(x),
                "yaxis": axis(y),
            }),
        }
    }

    /// Adds a line; without a name it has no legend entry.
    pub(super) fn line(mut self, name: &str, colour: &str, x: Vec<f64>, y: Vec<f64>) -> Self {
        self.traces.push(json!({
            "type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "showlegend": !name.is_empty(),
            "line": { "color": colour, "width": 1.6 },
        }));
        self
    }

    /// Adds points; without a name they have no legend entry.
    pub(super) fn points(mut self, name: &str, colour: &str, x: Vec<f64>, y: Vec<f64>) -> Self {
        self.traces.push(json!({
            "type": "scatter", "mode": "markers", "x": x, "y": y, "name": name, "showlegend": !name.is_empty(),
            "marker": { "color": colour, "size": 5, "symbol": "circle-open" },
        }));
        self
    }

    /// Adds a dashed horizontal line at `y`.
    pub(super) fn level(mut self, name: &str, y: f64, [from, to]: [f64; 2]) -> Self {
        self.traces.push(json!({
            "type": "scatter", "mode": "lines", "x": [from, to], "y": [y, y], "name": name,
            "line": { "color": "#000000", "width": 1, "dash": "dash" },
        }));
        self
    }

    /// Adds a thin dotted vertical line at `x`.
    pub(super) fn mark(mut self, x: f64) -> Self {
        self.shapes.push(json!({
            "type": "line", "layer": "below", "xref": "x", "yref": "paper", "x0": x, "x1": x, "y0": 0, "y1": 1,
            "line": { "color": "#999999", "width": 1, "dash": "dot" },
        }));
        self
    }

    /// Sets the title and the limits of the y axis.
    pub(super) fn y_range(mut self, title: &str, low: f64, high: f64) -> Self {
        self.layout["yaxis"] = axis(title);
        self.layout["yaxis"]["range"] = json!([low, high]);
        self
    }

    pub(super) fn html(mut self) -> String {
        self.layout["shapes"] = self.shapes.into();
        format!("<div class=\"panel\">{}</div>", plot::html(&self.traces, &self.layout))
    }
}

fn axis(title: &str) -> Value {
    json!({ "title": { "text": title }, "automargin": true, "zeroline": false })
}
