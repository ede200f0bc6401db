//! Writing the estimates of segments with their posteriors.

use crate::asset::SegmentId;
use crate::estimate::{Posterior, WearEstimate};
use crate::store::database::rows::{any_of, excluded, finite, finite_or_none, rows_of_placeholders, to_json};
use crate::store::layouts::Columns;
use crate::store::transaction::{ROWS_PER_STATEMENT, Transaction};
use crate::store::{RunResult, StoreError};

/// The columns of an estimate.
const ESTIMATE: &str = "status, reason, median_um, mean_um, low_um, p25_um, p75_um, high_um, log_evidence, estimate, run_indicator_values";

/// A posterior's probabilities, with its depths as their layout.
fn posterior_columns(posterior: &Posterior) -> Result<Columns, StoreError> {
    let depths = to_json(&posterior.wear_um, "wear_um", "a posterior")?;
    Ok(Columns::of_numbers(depths, &posterior.probability))
}

/// An estimate to be written.
pub(in crate::store) struct WearRow<'a> {
    pub(in crate::store) generation: i64,
    pub(in crate::store) segment: &'a SegmentId,
    pub(in crate::store) result: &'a RunResult,
    /// Whether the segment is added by the same transaction and so has no earlier estimate.
    pub(in crate::store) is_first: bool,
}

impl Transaction {
    /// Inserts or replaces estimates of segments.
    pub(in crate::store) async fn set_wears(&mut self, wears: &[WearRow<'_>]) -> Result<(), StoreError> {
        for chunk in wears.chunks(ROWS_PER_STATEMENT) {
            self.set_estimates(chunk).await?;
            self.set_posteriors(chunk).await?;
        }
        Ok(())
    }

    async fn set_estimates(&mut self, wears: &[WearRow<'_>]) -> Result<(), StoreError> {
        let text = format!(
            "INSERT INTO wear_estimates (segment_id, generation, {ESTIMATE}) VALUES {}
             ON CONFLICT (segment_id, generation) DO UPDATE SET {}",
            rows_of_placeholders(wears.len(), 2 + ESTIMATE.split(", ").count()),
            excluded(ESTIMATE)
        );
        let mut columns = Vec::with_capacity(wears.len());
        for row in wears {
            let id = row.segment.0.as_str();
            let indicators = &row.result.indicators;
            for (name, value) in &indicators.values {
                finite(&format!("indicator {name} of segment {id}"), *value)?;
            }
            columns.push(Columns::of(indicators, "run_indicator_values", id)?);
        }
        self.store_layouts(&columns).await?;
        let mut query = sqlx::query(&text);
        for (row, indicators) in wears.iter().zip(&columns) {
            let wear = &row.result.wear;
            let id = row.segment.0.as_str();
            let without_posterior = WearEstimate { posterior: None, ..wear.clone() };
            let status = to_json(&wear.status, "status", id)?;
            query = query
                .bind(id)
                .bind(row.generation)
                .bind(status.trim_matches('"').to_owned())
                .bind(wear.reason.as_str())
                .bind(finite_or_none("median_um", wear.median_um)?)
                .bind(finite_or_none("mean_um", wear.mean_um)?)
                .bind(finite_or_none("low_um", wear.low_um)?)
                .bind(finite_or_none("p25_um", wear.p25_um)?)
                .bind(finite_or_none("p75_um", wear.p75_um)?)
                .bind(finite_or_none("high_um", wear.high_um)?)
                .bind(finite_or_none("log_evidence", wear.log_evidence)?)
                .bind(to_json(&without_posterior, "estimate", id)?)
                .bind(indicators.bytes.as_slice());
        }
        query.persistent(self.dialect.caches_optional_doubles()).execute(&mut *self.inner).await?;
        Ok(())
    }

    async fn set_posteriors(&mut self, wears: &[WearRow<'_>]) -> Result<(), StoreError> {
        let (with, mut without): (Vec<&WearRow<'_>>, Vec<_>) =
            wears.iter().partition(|row| row.result.wear.posterior.is_some());
        without.retain(|row| !row.is_first);
        if !without.is_empty() {
            let which = any_of(without.len(), &["segment_id =", "generation ="]);
            let text = format!("DELETE FROM wear_posteriors WHERE {which}");
            let query = sqlx::query(&text).persistent(self.dialect.caches_statement(without.len()));
            let query = without
                .iter()
                .fold(query, |query, row| query.bind(row.segment.0.as_str()).bind(row.generation));
            query.execute(&mut *self.inner).await?;
        }
        if !with.is_empty() {
            // Nearly all posteriors of a channel are over the same depths.
            let posterior = |row: &WearRow<'_>| row.result.wear.posterior.as_ref().map(posterior_columns);
            let columns: Vec<Columns> =
                with.iter().filter_map(|row| posterior(row)).collect::<Result<_, _>>()?;
            self.store_layouts(&columns).await?;
            let text = format!(
                "INSERT INTO wear_posteriors (segment_id, generation, posterior) VALUES {}
                 ON CONFLICT (segment_id, generation) DO UPDATE SET {}",
                rows_of_placeholders(with.len(), 3),
                excluded("posterior")
            );
            let mut query = sqlx::query(&text).persistent(self.dialect.caches_statement(with.len()));
            for (row, probability) in with.iter().zip(&columns) {
                query = query
                    .bind(row.segment.0.as_str())
                    .bind(row.generation)
                    .bind(probability.bytes.as_slice());
            }
            query.execute(&mut *self.inner).await?;
        }
        Ok(())
    }
}
