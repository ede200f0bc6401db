//! Times and counters among the series of a recording.

/// Detects values that rise by the same step from sample to sample, as no vibration does.
#[derive(Debug, Clone, Default)]
pub(super) struct Ramp {
    last: Option<f64>,
    step: Option<f64>,
    values: u64,
    broken: bool,
}

impl Ramp {
    /// Fewest values for a detection.
    const MIN_VALUES: u64 = 4;

    pub(super) fn add(&mut self, value: f64) {
        if self.broken {
            return;
        }
        if let Some(last) = self.last.replace(value) {
            let step = *self.step.get_or_insert(value - last);
            // Times are often rounded.
            self.broken = !(step > 0.0 && ((value - last) / step - 1.0).abs() <= 0.5);
        }
        self.values += 1;
    }

    pub(super) fn is_even(&self) -> bool {
        self.values >= Self::MIN_VALUES && !self.broken
    }
}
