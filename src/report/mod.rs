//! A report of an asset's records as one page for a browser or a printer, the same from the command line and
//! from the service.
//!
//! The page is self-contained: charts are SVG, so it can be saved, sent and printed without a script or a
//! server.

mod chart;
mod cover;
mod events;
mod page;
mod ticks;
mod verdict;
mod wording;

use jiff::Timestamp;

use crate::asset::WearLimits;
use crate::estimate::{MaintenanceEvent, WearEstimate};
use crate::signal::{AngleSource, AngleUsed, Indicators, Spectrum};

pub use cover::{Contents, Cover, Form};
pub use events::{ReportedAlarm, quantity_words, reading_words};
pub use wording::INDICATORS;
pub(crate) use wording::escape;

/// The contents of a report.
#[derive(Debug, Default)]
pub struct Report {
    /// The asset's name; `None` for records without an asset.
    pub asset: Option<String>,
    /// Facts about the asset, in the order shown: a term and its text.
    pub facts: Vec<(String, String)>,
    /// Limits on wear depth.
    pub limits: WearLimits,
    /// The records in time order.
    pub records: Vec<ReportedRecord>,
    /// Alarms with their histories.
    pub alarms: Vec<ReportedAlarm>,
    /// Maintenance events in time order.
    pub maintenance: Vec<MaintenanceEvent>,
    /// Whether some records have no time of their own: theirs count from 1970.
    pub has_undated: bool,
    /// Number of all records, if `records` does not contain all of them.
    pub all_records: Option<usize>,
    /// The spectrum of the last record.
    pub last_spectrum: Option<Spectrum>,
    /// Texts by the sender.
    pub cover: Cover,
    /// The sections to be shown.
    pub contents: Contents,
    /// A form for both; `None` in a file, which cannot be submitted.
    pub form: Option<Form>,
}

/// One record of a report.
#[derive(Debug, Clone)]
pub struct ReportedRecord {
    /// Its file name or identifier.
    pub name: String,
    /// The measuring channel.
    pub channel: String,
    /// The time of the first sample.
    pub start_time: Timestamp,
    /// Unit of its samples.
    pub unit: String,
    /// Rotational frequency of the driving shaft in hertz.
    pub shaft_speed_hz: Option<f64>,
    /// Its indicators.
    pub indicators: Indicators,
    /// The shaft's angle over which they were computed; `None` if no indicator needs one.
    pub shaft_angle: Option<AngleUsed>,
    /// The wear estimate after it; `None` without a library.
    pub wear: Option<WearEstimate>,
    /// The estimate in words, or why there is none.
    pub wear_words: String,
    /// Reference wear depth in µm from another source.
    pub reference_wear_um: Option<f64>,
}

impl Report {
    /// Renders the page.
    pub fn html(&self) -> String {
        page::html(self)
    }
}

/// The source of an angle and its uncertainty, in words.
pub fn angle_words(angle: &AngleUsed) -> String {
    match angle.source {
        AngleSource::Tachometer { angle_error_deg: Some(error), .. } => {
            format!("tachometer {}", error_words(error))
        }
        AngleSource::Tachometer { .. } => "tachometer".to_owned(),
        AngleSource::MeshPhase { harmonic, angle_error_deg, .. } => {
            format!("mesh harmonic {harmonic}, {}", error_words(angle_error_deg))
        }
        AngleSource::ConstantSpeed => "constant speed".to_owned(),
    }
}

/// An angle's error in words, which never claims that there is none.
fn error_words(error_deg: f64) -> String {
    if error_deg < 0.005 { "± less than 0.01°".to_owned() } else { format!("± {error_deg:.2}°") }
}
