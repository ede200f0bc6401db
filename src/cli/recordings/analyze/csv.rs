//! CSV output: one line per record, one column per indicator.

use std::collections::BTreeSet;

use super::record::AnalyzedRecord;
use crate::report::angle_words;
use crate::signal::Name;

/// Indicators whose columns come first.
const FIRST: [&str; 5] = ["rms", "kurtosis", "crest_factor", "omx", "mesh_2"];

/// The column of the estimate's novelty, which is also an indicator.
const NOVELTY: &str = "novelty";

pub(super) fn csv(records: &[AnalyzedRecord]) -> String {
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let mut writer = csv::Writer::from_writer(Vec::new());
    let all: BTreeSet<&Name> = records.iter().flat_map(|record| record.indicators.values.keys()).collect();
    let is_other = |name: &&str| !FIRST.contains(name) && *name != NOVELTY;
    let others: Vec<&str> = all.into_iter().map(Name::as_str).filter(is_other).collect();
    let mut header: Vec<&str> = vec![
        "file",
        "channel",
        "start_time",
        "sample_rate_hz",
        "samples",
        "unit",
        "shaft_speed_hz",
        "mesh_frequency_hz",
    ];
    header.extend(FIRST);
    header.extend([
        "wear_median_um",
        "wear_low_um",
        "wear_high_um",
        "wear_status",
        "wear_cause",
        NOVELTY,
        "wear_reason",
        "shaft_angle",
    ]);
    header.extend(&others);
    let rows = records.iter().map(|record| {
        let mut row = vec![
            record.file.clone(),
            record.channel.clone(),
            record.start_time.map_or_else(String::new, |time| time.to_string()),
            record.sample_rate_hz.to_string(),
            record.samples.to_string(),
            record.unit.clone(),
            number(record.shaft_speed_hz),
            number(record.mesh_frequency_hz),
        ];
        row.extend(FIRST.iter().map(|name| number(record.indicators.get(name))));
        let wear = record.wear.as_ref();
        row.extend(
            [wear.and_then(|w| w.median_um), wear.and_then(|w| w.low_um), wear.and_then(|w| w.high_um)]
                .map(number),
        );
        row.extend([record.status(), record.cause()].map(Option::unwrap_or_default));
        row.push(number(wear.and_then(|wear| Some(wear.novelty.as_ref()?.score))));
        row.push(record.wear_reason.clone());
        row.push(record.basis.shaft_angle.as_ref().map_or_else(String::new, angle_words));
        row.extend(others.iter().map(|name| number(record.indicators.get(name))));
        row
    });
    let header = header.into_iter().map(str::to_owned).collect::<Vec<_>>();
    for row in std::iter::once(header).chain(rows) {
        writer
            .write_record(row)
            .expect("writing to memory does not fail, and every row has the header's width");
    }
    let bytes = writer.into_inner().expect("flushing to memory does not fail");
    String::from_utf8(bytes).expect("only text was written")
}
