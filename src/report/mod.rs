//! A report of an asset's records as one page for a browser or a printer, the same from the command line and
//! from the service.
//!
//! Everything is in the page: drawings are SVG, so that it can be kept, sent and printed without a script or
//! a server.

mod chart;
mod cover;
mod occurrences;
mod page;
mod ticks;

use jiff::Timestamp;

use crate::asset::WearLimits;
use crate::estimate::{MaintenanceEvent, WearEstimate};
use crate::signal::{AngleSource, AngleUsed, Indicators, Spectrum};

pub use cover::{Contents, Cover, Form};
pub use occurrences::{ReportedAlarm, quantity_words};
pub use page::INDICATORS;

/// What a report tells of.
#[derive(Debug, Default)]
pub struct Report {
    /// The asset's name, or none for records that belong to no asset.
    pub asset: Option<String>,
    /// What is known of the asset, in the order it is shown: a term and its words.
    pub facts: Vec<(String, String)>,
    /// Limits on wear depth.
    pub limits: WearLimits,
    /// The records in time order.
    pub records: Vec<ReportedRecord>,
    /// Alarms that anything happened to.
    pub alarms: Vec<ReportedAlarm>,
    /// What was done to the machine, in time order.
    pub maintenance: Vec<MaintenanceEvent>,
    /// How many records there are in all, where not all of them are given.
    pub all_records: Option<usize>,
    /// The spectrum of the last record.
    pub last_spectrum: Option<Spectrum>,
    /// What the sender says.
    pub cover: Cover,
    /// Its parts.
    pub contents: Contents,
    /// A form for both; none in a file, which nobody answers.
    pub form: Option<Form>,
}

/// One record of a report.
#[derive(Debug, Clone)]
pub struct ReportedRecord {
    /// The file or the identifier that it has.
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
    /// The shaft's angle that they were computed over; none where no indicator is over an angle.
    pub shaft_angle: Option<AngleUsed>,
    /// The wear estimate after it; none where there is no library.
    pub wear: Option<WearEstimate>,
    /// The same in words, or why there is none.
    pub wear_words: String,
    /// Wear depth in µm known from elsewhere.
    pub reference_wear_um: Option<f64>,
}

impl Report {
    /// The page.
    pub fn html(&self) -> String {
        page::html(self)
    }
}

/// Where an angle came from, and how sure it is, in a few words.
pub fn angle_words(angle: &AngleUsed) -> String {
    match angle.source {
        AngleSource::Tachometer { angle_error_deg: Some(error), .. } => format!("tachometer ± {error:.2}°"),
        AngleSource::Tachometer { .. } => "tachometer".to_owned(),
        AngleSource::MeshPhase { harmonic, angle_error_deg, .. } => {
            format!("mesh phase {harmonic} ± {angle_error_deg:.2}°")
        }
        AngleSource::ConstantSpeed => "constant speed".to_owned(),
    }
}
