//! The angle of the driving shaft, and records resampled over it (order tracking), at any speed.

use super::analyzer::Analyzer;
use super::angle_record::{AngleRecord, OrderSpectrum};
use super::mesh_context::MeshContext;
use super::mesh_phase::MeshBand;
use super::moments::Moments;
use super::not_computed::NotComputed;
use super::record::RecordOf;
use super::resampling::MIN_TURNS;
use super::shaft_angle::ShaftAngle;
use super::speed::{LocatedMesh, given_speed};

/// A record over its shaft angle, with the reason if it has a tachometer that was not used; or why there is
/// no angle.
pub(super) type AngleRecordResult = Result<(AngleRecord, Option<String>), NotComputed>;

impl Analyzer {
    /// Determines the angle of the driving shaft without a tachometer: from the phase of a mesh harmonic near
    /// the mesh comb; if the line leaves that band, anywhere within the tolerance of the speed; else from the
    /// record's constant speed. [`ShaftAngle::source`] tells which.
    ///
    /// # Errors
    /// Why there is no shaft speed, as for the mesh lines of [`analyze`](Self::analyze).
    pub fn shaft_angle(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Result<ShaftAngle, NotComputed> {
        let (moments, located) = self.locate(record, mesh);
        let angle = self.tracked_angle(record, mesh, moments.constant, located.mesh);
        self.release_large_buffers(record);
        angle
    }

    /// Determines the angle for the record that was transformed last, with its mesh frequency at `located`
    /// bins.
    fn tracked_angle(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        constant: bool,
        located: Result<f64, NotComputed>,
    ) -> Result<ShaftAngle, NotComputed> {
        let work = &mut self.work;
        let resolution_hz = work.resolution_hz(record);
        let speed_hz = given_speed(record).map_or(mesh.nominal_shaft_speed_hz, |(speed_hz, _)| speed_hz);
        let band = |mesh_hz: f64| MeshBand {
            bins: &work.bins,
            length: work.length,
            sample_rate_hz: record.sample_rate_hz(),
            teeth: mesh.teeth,
            mesh_hz,
        };
        let located_hz = located.map(|bins| bins * resolution_hz);
        let usable = mesh.teeth > 0 && speed_hz > 0.0 && speed_hz.is_finite() && !constant;
        let mut angle = None;
        if let Ok(mesh_hz) = located_hz
            && usable
        {
            angle = match work.tracked_angle.take() {
                Some(angle) => angle,
                None => band(mesh_hz).track_known(&mut work.transforms),
            };
        }
        if angle.is_none() && usable {
            angle = band(f64::from(mesh.teeth) * speed_hz)
                .track_wide(mesh.tolerance.max(0.0), &mut work.transforms);
        }
        match (angle, located_hz) {
            (Some(angle), _) => Ok(angle),
            (None, Ok(mesh_hz)) => ShaftAngle::constant(mesh_hz / f64::from(mesh.teeth), record.duration_s())
                .ok_or(NotComputed::NoSpeed),
            (None, Err(reason)) => Err(reason),
        }
    }

    /// Resamples a record over the angle of the driving shaft: that of the record's tachometer if its pulses
    /// are usable, else [`shaft_angle`](Self::shaft_angle).
    ///
    /// # Errors
    /// Why there is no angle, or [`NotComputed::TooFewTurns`], [`NotComputed::AboveNyquist`],
    /// [`NotComputed::SpeedVaries`].
    pub fn angle_record(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Result<AngleRecord, NotComputed> {
        if let Some(Ok(angle_record)) = self.by_tachometer(record, mesh) {
            return Ok(angle_record);
        }
        let angle = self.shaft_angle(record, mesh)?;
        self.resampled(record, mesh, &angle)
    }

    pub(super) fn resampled(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        angle: &ShaftAngle,
    ) -> Result<AngleRecord, NotComputed> {
        self.resampler.resample(record, angle, f64::from(mesh.teeth) + 1.0)
    }

    /// Resamples a record over its tachometer's angle; an error tells why its pulses cannot be used. `None`
    /// without a tachometer.
    fn by_tachometer(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Option<Result<AngleRecord, String>> {
        Some(match record.tachometer_angle()? {
            Ok(angle) => self.resampled(record, mesh, &angle).map_err(|reason| match reason {
                NotComputed::TooFewTurns => {
                    format!("its pulses cover fewer than {MIN_TURNS} whole turns of the record")
                }
                NotComputed::AboveNyquist => {
                    "at its speed the mesh frequency lies above 42 % of the sampling rate".to_owned()
                }
                _ => "its speed varies too much".to_owned(),
            }),
            Err(error) => Err(error.to_string()),
        })
    }

    /// Returns the amplitude spectrum over orders of the driving shaft; errors as for
    /// [`angle_record`](Self::angle_record).
    pub fn order_spectrum(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
    ) -> Result<OrderSpectrum, NotComputed> {
        let angle_record = self.angle_record(record, mesh)?;
        Ok(angle_record.order_spectrum(&mut self.work.transforms))
    }

    /// Resamples the record that was transformed last over the best available angle, or returns its `fault`.
    pub(super) fn angle_record_located(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        (moments, located): &(Moments, LocatedMesh),
        fault: Option<NotComputed>,
    ) -> AngleRecordResult {
        match fault {
            Some(fault) => Err(fault),
            None => self.best_angle_record(record, mesh, moments, located),
        }
    }

    /// Recycles the buffer of a record over an angle.
    pub(super) fn recycle(&mut self, angle_record: AngleRecordResult) {
        if let Ok((angle_record, _)) = angle_record {
            self.resampler.recycle(angle_record);
        }
    }

    /// Resamples the record over the best available angle, without the lines of other meshes.
    pub(super) fn best_angle_record(
        &mut self,
        record: &RecordOf<'_>,
        mesh: &MeshContext,
        moments: &Moments,
        located: &LocatedMesh,
    ) -> AngleRecordResult {
        let refused = match self.by_tachometer(record, mesh) {
            Some(Ok(angle_record)) => return Ok((angle_record.without_other_meshes(mesh), None)),
            Some(Err(reason)) => Some(reason),
            None => None,
        };
        let angle = self.tracked_angle(record, mesh, moments.constant, located.mesh)?;
        let resampled = self.resampled(record, mesh, &angle);
        angle.recycle(&mut self.work.transforms);
        Ok((resampled?.without_other_meshes(mesh), refused))
    }
}
