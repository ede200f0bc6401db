//! Names, times and escaped text as the page shows them.

/// Indicators that can be shown: name, heading and caption.
pub const INDICATORS: [(&str, &str, &str); 8] = [
    ("rms", "RMS", "Root mean square of each record, mean not removed."),
    ("velocity_rms", "Velocity RMS", "Root mean square of the velocity from 10 to 1000 Hz, as in ISO 20816."),
    ("kurtosis", "Kurtosis", "Gaussian noise has 3, a sine 1.5."),
    ("omx", "OMX", "Peak amplitude of the first mesh order."),
    (
        "omx_tracked",
        "OMX, order-tracked",
        "Peak amplitude of the first mesh order over the shaft's angle: a changing speed does not smear it.",
    ),
    ("fm0", "FM0", "Peak to peak of the synchronous average over the sum of its mesh harmonics."),
    ("fm4", "FM4", "Kurtosis of the difference signal: single damaged teeth raise it above 3."),
    (
        "na4",
        "NA4",
        "Fourth moment of the residual over the squared mean of its variance in the run so far: grows with spreading damage.",
    ),
];

/// Format of a time of day.
pub(super) const MINUTES: &str = "%Y-%m-%d %H:%M UTC";

/// Escapes text for HTML.
pub(crate) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
