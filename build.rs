//! Compresses Plotly.js, with which the dashboard and the figures draw, for the program to embed.

use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    let path = Path::new(&std::env::var("OUT_DIR")?).join("plotly.js.gz");
    let mut encoder = GzEncoder::new(File::create(path)?, Compression::default());
    encoder.write_all(plotly_js().as_bytes())?;
    encoder.finish()?;
    Ok(())
}

/// The script in the `plotly` crate without the surrounding HTML, and without MathJax, which the crate
/// appends.
fn plotly_js() -> String {
    let sources = plotly::Plot::offline_js_sources();
    let begin = sources.find('>').map_or(0, |tag_end| tag_end + 1);
    // The script itself contains the end tag only within lines.
    let end = sources.match_indices("</script>\n").next().map_or(sources.len(), |(at, _)| at);
    sources.get(begin..end).unwrap_or_default().to_owned()
}
