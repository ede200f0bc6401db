//! The levels of lines in spectra of a record, and in those of its baseline records.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tokio::task::JoinSet;

use super::line_cache::Axis;
use crate::asset::Segment;
use crate::http::problem::Problem;
use crate::service::{BandChoice, Service, ServiceError};
use crate::signal::NotComputed;

/// Number of spectra computed at the same time: each holds a whole record.
const MAX_CONCURRENT: usize = 4;

/// The spectrum in which lines are read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum SpectrumKind {
    /// The amplitude spectrum.
    #[default]
    Amplitude,
    /// The envelope spectrum.
    Envelope,
}

/// Lines of one spectrum.
#[derive(Debug, Clone)]
pub(crate) struct SpectrumLines {
    pub(crate) kind: SpectrumKind,
    pub(crate) axis: Axis,
    /// Positions in the unit of the axis.
    pub(crate) positions: Vec<f64>,
    /// The band of the envelope.
    pub(crate) band: BandChoice,
}

/// The amplitude of each line; none beyond the spectrum.
type Amplitudes = Vec<Option<f64>>;

impl SpectrumLines {
    /// The amplitudes in the spectrum of a segment, and the band of its envelope.
    pub(crate) async fn compute(
        &self,
        service: &Service,
        segment: &Segment,
    ) -> Result<Result<(Amplitudes, Option<[f64; 2]>), NotComputed>, ServiceError> {
        match self.kind {
            SpectrumKind::Amplitude => {
                let amplitudes = self.of_amplitude(service, segment).await?;
                Ok(amplitudes.map(|amplitudes| (amplitudes, None)))
            }
            SpectrumKind::Envelope => {
                let Some(unit_hz) = self.axis.unit_hz(segment) else {
                    return Ok(Err(NotComputed::NoSpeed));
                };
                let envelope = service.records.envelope(segment, self.band).await?;
                let resolution = envelope.spectrum.resolution_hz / unit_hz;
                let amplitudes = read(&self.positions, &envelope.spectrum.amplitude, resolution);
                Ok(Ok((amplitudes, Some(envelope.band.band_hz))))
            }
        }
    }

    async fn of_amplitude(
        &self,
        service: &Service,
        segment: &Segment,
    ) -> Result<Result<Amplitudes, NotComputed>, ServiceError> {
        let Self { axis, positions, .. } = self.clone();
        service
            .records
            .analyse_stored(segment, "read the lines of a spectrum", move |analyzer, record, mesh| match axis
            {
                Axis::Hz => {
                    let spectrum = analyzer.amplitude_spectrum(record);
                    Ok(read(&positions, &spectrum.amplitude, spectrum.resolution_hz))
                }
                Axis::Orders => analyzer
                    .order_spectrum(record, mesh)
                    .map(|spectrum| read(&positions, &spectrum.amplitude, spectrum.resolution_orders)),
            })
            .await
    }

    /// The amplitudes in the spectra of the baseline records of a segment, at the same orders if the shaft
    /// speeds are known. Records without raw bytes or speed, or that do not resolve the band, are left out.
    pub(crate) async fn of_baseline(
        &self,
        service: &Arc<Service>,
        segment: &Segment,
        baseline: &[Segment],
    ) -> Result<Vec<Amplitudes>, Problem> {
        let mut healthy = Vec::new();
        for some in baseline.chunks(MAX_CONCURRENT) {
            let mut tasks = JoinSet::new();
            for record in some {
                let scale = match self.axis {
                    Axis::Hz => speed_ratio(record, segment),
                    Axis::Orders => 1.0,
                };
                let positions = self.positions.iter().map(|at| at * scale).collect();
                let (lines, service, record) =
                    (Self { positions, ..self.clone() }, Arc::clone(service), record.clone());
                tasks.spawn(async move { lines.compute(&service, &record).await });
            }
            while let Some(done) = tasks.join_next().await {
                match done.map_err(|_| ServiceError::WorkerLost("read the lines of a spectrum"))? {
                    Ok(Ok((read, _))) => healthy.push(read),
                    Ok(Err(_)) | Err(ServiceError::Field { field: "band_hz", .. }) => {}
                    Err(error) if error.is_raw_unavailable() => {}
                    Err(error) => return Err(error.into()),
                }
            }
        }
        Ok(healthy)
    }
}

/// Shaft speed of a record relative to that of another; 1 if either is unknown.
fn speed_ratio(record: &Segment, other: &Segment) -> f64 {
    let speeds = record.shaft_speed.zip(other.shaft_speed);
    speeds.map_or(1.0, |(one, two)| one.shaft_speed_hz / two.shaft_speed_hz)
}

fn read(positions: &[f64], amplitude: &[f64], resolution: f64) -> Amplitudes {
    positions.iter().map(|at| line_at(amplitude, at / resolution)).collect()
}

/// The maximum of the bin nearest to a place and the two beside it, as a tone may fall between two; `None`
/// beyond the spectrum.
fn line_at(amplitude: &[f64], place: f64) -> Option<f64> {
    let nearest = place.round() as usize;
    let around = nearest.saturating_sub(1)..amplitude.len().min(nearest + 2);
    (nearest < amplitude.len()).then(|| amplitude[around].iter().copied().fold(0.0, f64::max))
}

/// The geometric mean of positive values; `None` if one is missing or there are none.
pub(crate) fn geometric_mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let logarithms: Vec<f64> =
        values.map(|value| value.filter(|value| *value > 0.0).map(f64::ln)).collect::<Option<_>>()?;
    (!logarithms.is_empty()).then(|| (logarithms.iter().sum::<f64>() / logarithms.len() as f64).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_between_two_bins_is_found() {
        let amplitude = [0.0, 1.0, 5.0, 1.0, 0.0];
        let at = |place| line_at(&amplitude, place);
        assert_eq!([at(1.4), at(3.0), at(0.0), at(4.0)], [Some(5.0), Some(5.0), Some(1.0), Some(1.0)]);
        assert_eq!(at(4.6), None);
    }

    #[test]
    fn the_mean_of_levels_is_geometric() {
        let mean = |values: &[Option<f64>]| geometric_mean(values.iter().copied());
        assert!((mean(&[Some(1.0), Some(100.0)]).unwrap() - 10.0).abs() < 1e-12);
        assert_eq!([mean(&[]), mean(&[Some(1.0), None]), mean(&[Some(0.0)])], [None, None, None]);
    }
}
