//! A report of analysed records as one HTML page, for a browser or a printer.

use std::collections::BTreeMap;

use plotly::common::{Fill, Line, Mode};
use plotly::layout::Axis;
use plotly::{Layout, Plot, Scatter};

use super::analyze::AnalyzedRecord;
use crate::asset::AssetSpec;
use crate::http::plotly_js;
use crate::signal::Spectrum;

/// The page; self-contained, so that it can be kept and sent.
pub(super) fn html(asset: Option<&AssetSpec>, records: &[AnalyzedRecord], last_spectrum: Option<&Spectrum>) -> String {
    let title = asset.map_or_else(
        || "Vibration report".to_owned(),
        |asset| format!("Vibration report: {}", asset.name_or_id()),
    );
    let mut sections = String::new();
    let channels: BTreeMap<&str, Vec<&AnalyzedRecord>> = records.iter().fold(BTreeMap::new(), |mut channels, record| {
        channels.entry(record.channel.as_str()).or_insert_with(Vec::new).push(record);
        channels
    });
    for (channel, records) in &channels {
        if records.iter().any(|record| record.wear.is_some()) {
            let caption = format!("Channel {channel}: median, and the interval that holds the wear depth with 90 % probability.");
            sections += &section("Wear depth", &caption, wear_plot(records));
        }
    }
    for (name, heading, caption) in INDICATORS {
        let mut plot = plot("start of the record (UTC)", heading);
        let mut any = false;
        for (channel, records) in &channels {
            let values: Vec<Option<f64>> = records.iter().map(|record| record.indicators.get(name)).collect();
            any |= values.iter().any(Option::is_some);
            plot.add_trace(Scatter::new(times(records), values).mode(Mode::LinesMarkers).name(*channel));
        }
        if any {
            sections += &section(heading, caption, plot);
        }
    }
    if let Some(spectrum) = last_spectrum {
        let frequency_hz: Vec<f64> = (0..spectrum.amplitude.len())
            .map(|bin| bin as f64 * spectrum.resolution_hz)
            .collect();
        let mut plot = plot("frequency (Hz)", &format!("peak amplitude ({})", spectrum.unit));
        plot.add_trace(
            Scatter::new(frequency_hz, spectrum.amplitude.clone())
                .mode(Mode::Lines)
                .name("spectrum"),
        );
        let caption = format!(
            "Last record: {} window, bandwidth {:.3} Hz.",
            spectrum.window, spectrum.bandwidth_hz
        );
        sections += &section("Spectrum", &caption, plot);
    }
    let rows: String = records.iter().map(row).collect();
    let title = escape(&title);
    format!(
        "<!doctype html><html lang=\"en\"><head><meta charset=\"utf-8\"><title>{title}</title><style>{STYLE}</style><script>{script}</script></head>\
         <body><h1>{title}</h1><p>{count} records.</p>{sections}<h2>Records</h2><table><thead><tr><th>File</th><th>Channel</th><th>Start (UTC)</th>\
         <th>Shaft (Hz)</th><th>RMS</th><th>Kurtosis</th><th>OMX</th><th>Wear</th></tr></thead><tbody>{rows}</tbody></table></body></html>",
        // An end tag within the script's own strings must not end the element.
        script = plotly_js().replace("</script", "<\\/script"),
        count = records.len(),
    )
}

/// Indicators that are drawn: name, heading and caption.
const INDICATORS: [(&str, &str, &str); 3] = [
    (
        "rms",
        "RMS",
        "Root mean square of each record, in the record's unit, mean not removed.",
    ),
    ("kurtosis", "Kurtosis", "Gaussian noise has 3, a sine 1.5."),
    ("omx", "OMX", "Peak amplitude of the first mesh order, in the record's unit."),
];

const STYLE: &str = "body{font:15px/1.45 system-ui,sans-serif;max-width:1100px;margin:2rem auto;padding:0 1rem;color:#1b1f24}\
    table{border-collapse:collapse;width:100%;font-variant-numeric:tabular-nums}th,td{border-bottom:1px solid #d0d7de;padding:.3rem .5rem;text-align:left}\
    figure{margin:0 0 1.5rem;break-inside:avoid}figcaption{color:#57606a}";

fn plot(x: &str, y: &str) -> Plot {
    let mut plot = Plot::new();
    plot.set_layout(Layout::new().height(340).x_axis(Axis::new().title(x)).y_axis(Axis::new().title(y)));
    plot
}

fn times(records: &[&AnalyzedRecord]) -> Vec<String> {
    records.iter().map(|record| record.start_time.to_string()).collect()
}

fn wear_plot(records: &[&AnalyzedRecord]) -> Plot {
    let times = times(records);
    let column = |pick: fn(&AnalyzedRecord) -> Option<f64>| records.iter().map(|record| pick(record)).collect::<Vec<_>>();
    let mut plot = plot("start of the record (UTC)", "wear depth (µm)");
    let edge = || Line::new().width(0.0);
    let low = column(|record| record.wear.as_ref()?.p05_um);
    let high = column(|record| record.wear.as_ref()?.p95_um);
    plot.add_trace(Scatter::new(times.clone(), low).mode(Mode::Lines).line(edge()).show_legend(false));
    plot.add_trace(
        Scatter::new(times.clone(), high)
            .mode(Mode::Lines)
            .line(edge())
            .fill(Fill::ToNextY)
            .name("5 % to 95 %"),
    );
    plot.add_trace(
        Scatter::new(times.clone(), column(|record| record.wear.as_ref()?.median_um))
            .mode(Mode::Lines)
            .name("median"),
    );
    let reference = column(|record| record.reference_wear_um);
    if reference.iter().any(Option::is_some) {
        plot.add_trace(
            Scatter::new(times.clone(), reference)
                .mode(Mode::Lines)
                .name("reference (simulated or inspected)"),
        );
    }
    plot
}

fn section(heading: &str, caption: &str, plot: Plot) -> String {
    let (heading, caption) = (escape(heading), escape(caption));
    format!(
        "<h2>{heading}</h2><figure>{}<figcaption>{caption}</figcaption></figure>",
        plot.to_inline_html(None)
    )
}

fn row(record: &AnalyzedRecord) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "–".to_owned(), |value| format!("{value:.4}"));
    format!(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
        escape(&record.file),
        escape(&record.channel),
        record.start_time,
        number(record.shaft_speed_hz),
        number(record.indicators.get("rms")),
        number(record.indicators.get("kurtosis")),
        number(record.indicators.get("omx")),
        escape(&record.wear_reason),
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}
