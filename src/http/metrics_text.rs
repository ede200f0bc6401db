//! Prometheus' text format.

use std::fmt::Write;

/// The lines of the page.
#[derive(Default)]
pub(super) struct MetricsText(String);

impl MetricsText {
    pub(super) fn head(&mut self, name: &str, kind: &str, help: &str) {
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}");
    }

    pub(super) fn line(&mut self, name: &str, labels: &[(&str, &str)], value: impl std::fmt::Display) {
        self.0.push_str(name);
        for (n, (label, value)) in labels.iter().enumerate() {
            self.0.push(if n == 0 { '{' } else { ',' });
            self.0.push_str(label);
            self.0.push_str("=\"");
            self.escaped(value);
            self.0.push('"');
        }
        if !labels.is_empty() {
            self.0.push('}');
        }
        let _ = writeln!(self.0, " {value}");
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

    pub(super) fn single(&mut self, name: &str, kind: &str, help: &str, value: impl std::fmt::Display) {
        self.head(name, kind, help);
        self.line(name, &[], value);
    }

    pub(super) fn into_string(self) -> String {
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
}
