//! Plotly.js, with which the dashboard and the pages of the commands draw: the published bundle for Cartesian
//! plots.

use std::io::Read;

use flate2::read::GzDecoder;

/// The script, compressed with gzip.
pub(super) const PLOTLY_JS_GZIP: &[u8] = include_bytes!("plotly/plotly-cartesian.min.js.gz");

/// Returns the script as text.
pub fn plotly_js() -> String {
    let mut script = String::new();
    if let Err(error) = GzDecoder::new(PLOTLY_JS_GZIP).read_to_string(&mut script) {
        tracing::error!(%error, "failed to decompress the embedded Plotly.js");
    }
    script
}
