//! Plotly.js, which `build.rs` takes from the `plotly` crate and compresses.

use std::io::Read;

use flate2::read::GzDecoder;

/// The script, compressed with gzip.
pub(super) const PLOTLY_JS_GZIP: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/plotly.js.gz"));

/// Returns the script as text.
pub fn plotly_js() -> String {
    let mut script = String::new();
    if let Err(error) = GzDecoder::new(PLOTLY_JS_GZIP).read_to_string(&mut script) {
        tracing::error!(%error, "failed to decompress the embedded Plotly.js");
    }
    script
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
