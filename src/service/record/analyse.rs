//! The analysis of one record: its indicators and features.

use std::sync::Arc;

use jiff::Timestamp;
use rayon::prelude::*;

use super::identify::IdentifiedRecord;
use crate::asset::AssetSpec;
use crate::service::error::ServiceError;
use crate::service::keys::analysis_keys;
use crate::service::workers::{Workers, is_large, with_analyzer};
use crate::signal::{Condition, Record};
use crate::store::{Analysed, NewSegment};

/// Computes the indicators and features of a record. To be called on a worker thread.
pub(crate) fn analyse(record: &Record, spec: &AssetSpec) -> Analysed {
    let bearings = spec.bearings();
    let Condition { analysis, basis } = with_analyzer(record.samples().len(), |analyzer| {
        analyzer.condition(&spec.seen_from_shaft(record), &spec.condition_settings(&bearings))
    });
    Analysed {
        keys: analysis_keys(spec),
        shaft_speed: analysis.shaft_speed,
        basis,
        indicators: analysis.indicators,
        features: analysis.features,
    }
}

/// Analyses records on worker threads; returns their segments in the same order.
pub(crate) async fn analyse_all(
    workers: &Workers,
    spec: &AssetSpec,
    records: &Arc<Vec<IdentifiedRecord>>,
    received_at: Timestamp,
) -> Result<Vec<NewSegment>, ServiceError> {
    const TASK: &str = "analyse records";
    let ordinary = {
        let (spec, records) = (spec.clone(), Arc::clone(records));
        let analyse = move |record: &IdentifiedRecord| {
            (!is_large(record.samples())).then(|| segment(record, &spec, received_at))
        };
        move || records.par_iter().map(analyse).collect::<Vec<_>>()
    };
    let mut analysed = Vec::with_capacity(records.len());
    for (n, ready) in workers.run(TASK, ordinary).await?.into_iter().enumerate() {
        if let Some(ready) = ready {
            analysed.push(ready);
            continue;
        }
        // Large records one after the other: memory may not suffice for two.
        let (spec, of) = (spec.clone(), Arc::clone(records));
        let large = move || segment(&of[n], &spec, received_at);
        analysed.push(workers.run_analysis(TASK, records[n].samples(), large).await?);
    }
    Ok(analysed)
}

fn segment(identified: &IdentifiedRecord, spec: &AssetSpec, received_at: Timestamp) -> NewSegment {
    let record = &identified.record;
    NewSegment {
        id: identified.id.clone(),
        asset_id: spec.id.clone(),
        channel: record.channel().to_string(),
        start_time: record.start_time(),
        received_at,
        sample_rate_hz: record.sample_rate_hz(),
        samples: identified.samples() as u64,
        unit: record.unit().to_string(),
        operating_point: record.operating_point(),
        reference_wear_um: identified.reference_wear_um,
        raw: identified.raw.clone(),
        excluded: identified.excluded,
        analysed: analyse(record, spec),
    }
}
