//! Plotly.js from the `plotly` crate's embedded copy.

/// The script without the surrounding HTML, and without MathJax, which the crate appends and which is loaded
/// from elsewhere.
pub fn plotly_js() -> String {
    let sources = plotly::Plot::offline_js_sources();
    let begin = sources.find('>').map_or(0, |tag_end| tag_end + 1);
    // The script itself contains the end tag only within lines.
    let end = sources.match_indices("</script>\n").next().map_or(sources.len(), |(at, _)| at);
    sources.get(begin..end).unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_is_plotly_alone() {
        let script = plotly_js();
        assert!(script.trim_start().starts_with("/**\n* plotly.js v"), "{:?}", &script[..60]);
        assert!(!script.contains("MathJax=") && script.len() > 3_000_000, "{} bytes", script.len());
        assert!(!script.trim_end().ends_with("</script>"));
    }
}
