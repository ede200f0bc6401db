//! Prometheus' text format.

use std::fmt::Write;

/// The lines of the page.
#[derive(Default)]
pub(crate) struct MetricsText(String);

/// The labels of a channel, formatted once for all of its lines.
pub(crate) struct ChannelLabels(String);

impl ChannelLabels {
    pub(crate) fn new(asset: &str, channel: &str) -> Self {
        let mut text = MetricsText::default();
        text.labels(&[("asset", asset), ("channel", channel)]);
        Self(text.0)
    }
}

impl MetricsText {
    pub(crate) fn head(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    pub(crate) fn line(&mut self, name: &str, labels: &[(&str, &str)], value: impl std::fmt::Display) {
        self.0.push_str(name);
        if !labels.is_empty() {
            self.0.push('{');
            self.labels(labels);
            self.0.push('}');
        }
        let _ = writeln!(self.0, " {value}");
    }

    /// A line of a channel, with one label more than those of the channel.
    pub(crate) fn channel_line(
        &mut self,
        name: &str,
        channel: &ChannelLabels,
        (label, label_value): (&str, &str),
        value: f64,
    ) {
        for part in [name, "{", &channel.0, ","] {
            self.0.push_str(part);
        }
        self.labels(&[(label, label_value)]);
        self.0.push_str("} ");
        self.0.push_str(zmij::Buffer::new().format(value));
        self.0.push('\n');
    }

    fn labels(&mut self, labels: &[(&str, &str)]) {
        for (n, (label, value)) in labels.iter().enumerate() {
            if n > 0 {
                self.0.push(',');
            }
            self.0.push_str(label);
            self.0.push_str("=\"");
            self.escaped(value);
            self.0.push('"');
        }
    }

    fn escaped(&mut self, value: &str) {
        // Hardly any has one.
        if !value.bytes().any(|byte| matches!(byte, b'\\' | b'"' | b'\n')) {
            self.0.push_str(value);
            return;
        }
        for sign in value.chars() {
            match sign {
                '\n' => self.0.push_str("\\n"),
                '\\' | '"' => self.0.extend(['\\', sign]),
                _ => self.0.push(sign),
            }
        }
    }

    /// Writes a gauge with one value.
    pub(crate) fn gauge(&mut self, name: &str, help: &str, value: impl std::fmt::Display) {
        self.head(name, "gauge", help);
        self.line(name, &[], value);
    }

    pub(crate) fn into_string(self) -> String {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_escaped() {
        let mut text = MetricsText::default();
        text.line("up", &[("a", r#"back\slash "and" quote"#), ("b", "two\nlines"), ("c", "")], 1.5);
        text.line("down", &[], 2);
        let expected = "up{a=\"back\\\\slash \\\"and\\\" quote\",b=\"two\\nlines\",c=\"\"} 1.5\ndown 2\n";
        assert_eq!(text.into_string(), expected);
    }

    #[test]
    fn lines_of_a_channel_are_those_of_all_its_labels() {
        let channel = ChannelLabels::new("pump \"A\"", "1");
        for (value, written) in [(1.25, "1.25"), (2.0, "2.0"), (-3e-7, "-3e-7"), (1e300, "1e+300")] {
            let (mut text, mut expected) = (MetricsText::default(), MetricsText::default());
            text.channel_line("rms", &channel, ("unit", "a\\b"), value);
            let labels = [("asset", "pump \"A\""), ("channel", "1"), ("unit", "a\\b")];
            expected.line("rms", &labels, written);
            assert_eq!(text.into_string(), expected.into_string());
        }
    }
}
