//! Piecewise cubic interpolation that preserves monotonicity.

use thiserror::Error;

/// Why points cannot be interpolated.
#[derive(Debug, Clone, Copy, Error, PartialEq)]
pub(super) enum PchipError {
    /// Fewer than two points.
    #[error("{0} points, expected at least 2")]
    TooFew(usize),
    /// A point that is not finite or not greater than the one before.
    #[error("point {0} is not finite or not greater than the one before")]
    NotRising(usize),
}

/// The monotone cubic Hermite interpolant of Fritsch and Butland (1984), with the three-point end slopes of
/// SciPy's `PchipInterpolator`. It passes through every point and has no extremum between two of them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pchip {
    x: Vec<f64>,
    y: Vec<f64>,
    /// The slope at each point.
    slope: Vec<f64>,
}

/// The cubic between two points.
#[derive(Debug, Clone, Copy)]
struct Piece {
    begin: f64,
    width: f64,
    value: f64,
    rise: f64,
    slopes: [f64; 2],
}

impl Pchip {
    /// Interpolates `y` over strictly ascending `x` of the same length. `slope` gives the memory for the
    /// slopes.
    pub(super) fn new(x: Vec<f64>, y: Vec<f64>, mut slope: Vec<f64>) -> Result<Self, PchipError> {
        let n = x.len().min(y.len());
        if n < 2 {
            return Err(PchipError::TooFew(n));
        }
        let rises = |i: usize| x[i] > x[i - 1] && x[i].is_finite() && y[i].is_finite();
        if !(x[0].is_finite() && y[0].is_finite()) {
            return Err(PchipError::NotRising(0));
        }
        if let Some(index) = (1..n).find(|&i| !rises(i)) {
            return Err(PchipError::NotRising(index));
        }
        let width = |i: usize| x[i + 1] - x[i];
        let secant = |i: usize| (y[i + 1] - y[i]) / width(i);
        slope.clear();
        slope.resize(n, secant(0));
        if n > 2 {
            slope[0] = end_slope(width(0), width(1), secant(0), secant(1));
            slope[n - 1] = end_slope(width(n - 2), width(n - 3), secant(n - 2), secant(n - 3));
            let (mut h_before, mut before) = (width(0), secant(0));
            for (i, slope) in slope.iter_mut().enumerate().take(n - 1).skip(1) {
                let (h, after) = (width(i), secant(i));
                *slope = if before * after > 0.0 {
                    let (w1, w2) = (2.0 * h + h_before, h + 2.0 * h_before);
                    (w1 + w2) / (w1 / before + w2 / after)
                } else {
                    0.0
                };
                (h_before, before) = (h, after);
            }
        }
        Ok(Self { x, y, slope })
    }

    /// Returns the buffers for reuse.
    pub(super) fn into_buffers(self) -> [Vec<f64>; 3] {
        [self.x, self.y, self.slope]
    }

    /// The cubic from point `i` to the next one.
    #[inline]
    fn piece(&self, i: usize) -> Piece {
        Piece {
            begin: self.x[i],
            width: self.x[i + 1] - self.x[i],
            value: self.y[i],
            rise: self.y[i + 1] - self.y[i],
            slopes: [self.slope[i], self.slope[i + 1]],
        }
    }

    /// The x at which the cubic after the one from point `i` begins, if there is one.
    #[inline]
    fn next_begin(&self, i: usize) -> Option<f64> {
        (i + 2 < self.x.len()).then(|| self.x[i + 1])
    }

    /// Returns the x of all points.
    pub(super) fn nodes(&self) -> &[f64] {
        &self.x
    }

    /// Returns the y of all points.
    pub(super) fn values(&self) -> &[f64] {
        &self.y
    }

    /// Returns the first and the last x.
    pub(super) fn range(&self) -> [f64; 2] {
        [self.x[0], self.x[self.x.len() - 1]]
    }

    /// Returns the steepest slope between two points.
    pub(super) fn max_slope(&self) -> f64 {
        let secants = self.x.windows(2).zip(self.y.windows(2)).map(|(x, y)| (y[1] - y[0]) / (x[1] - x[0]));
        secants.fold(0.0, f64::max)
    }

    /// Returns the value at `x`, searching forward from `interval`, which advances with ascending `x`. Beyond
    /// the ends the outer cubics are extrapolated.
    #[inline]
    pub(super) fn at(&self, x: f64, interval: &mut usize) -> f64 {
        self.seek(x, interval);
        let Piece { begin, width, value, rise, slopes } = self.piece(*interval);
        let t = (x - begin) / width;
        let (u, t2) = (1.0 - t, t * t);
        value + rise * t2 * (3.0 - 2.0 * t) + width * t * u * (slopes[0] * u - slopes[1] * t)
    }

    /// Writes `scale` times the values at the ascending `from + steps[j]`, searching forward from `interval`
    /// as [`at`](Self::at) does.
    ///
    /// All points of one piece are computed from its cubic's coefficients in one loop, which the compiler
    /// vectorises.
    #[inline(always)]
    pub(super) fn sample_into(
        &self,
        from: f64,
        steps: &[f64],
        scale: f64,
        interval: &mut usize,
        values: &mut [f64],
    ) {
        let (mut steps, mut values) = (steps, values);
        while let Some(first) = steps.first() {
            self.seek(from + first, interval);
            let end = self.next_begin(*interval).unwrap_or(f64::INFINITY);
            let count = count_below(steps, end - from).max(1);
            let piece = self.piece(*interval);
            let [constant, linear, square, cube] = piece.coefficients().map(|c| scale * c);
            let (begin, per_width) = (piece.begin, piece.width.recip());
            let (here, rest) = values.split_at_mut(count);
            for (value, step) in here.iter_mut().zip(&steps[..count]) {
                let t = (from + step - begin) * per_width;
                *value = constant + t * (linear + t * (square + t * cube));
            }
            (steps, values) = (&steps[count..], rest);
        }
    }

    #[inline]
    fn seek(&self, x: f64, interval: &mut usize) {
        while let Some(begin) = self.next_begin(*interval)
            && x >= begin
        {
            *interval += 1;
        }
    }
}

impl Piece {
    /// Returns the coefficients in ascending powers of (x − begin)/width.
    fn coefficients(&self) -> [f64; 4] {
        let [first, last] = self.slopes.map(|slope| self.width * slope);
        [self.value, first, 3.0 * self.rise - 2.0 * first - last, first + last - 2.0 * self.rise]
    }
}

/// Returns how many of the ascending `steps`, which are about evenly spaced, lie below `end`. Counts from
/// where even spacing has it, as the branches of a binary search are not predictable.
#[inline(always)]
fn count_below(steps: &[f64], end: f64) -> usize {
    let [first, .., last] = steps else { return steps.iter().filter(|step| **step < end).count() };
    let per_step = (steps.len() - 1) as f64 / (last - first);
    let mut count = (((end - first) * per_step) as usize).min(steps.len());
    while count > 0 && steps[count - 1] >= end {
        count -= 1;
    }
    while count < steps.len() && steps[count] < end {
        count += 1;
    }
    count
}

/// Three-point slope at an end, limited to preserve monotonicity.
fn end_slope(h0: f64, h1: f64, secant0: f64, secant1: f64) -> f64 {
    let slope = ((2.0 * h0 + h1) * secant0 - h0 * secant1) / (h0 + h1);
    if slope * secant0 <= 0.0 {
        0.0
    } else if secant0 * secant1 <= 0.0 && slope.abs() > 3.0 * secant0.abs() {
        3.0 * secant0
    } else {
        slope
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A straight line and, between inner points, its own points come out.
    #[test]
    fn lines_are_exact() {
        let line = Pchip::new(vec![0.0, 1.0, 4.0, 5.0], vec![1.0, 3.0, 9.0, 11.0], Vec::new()).unwrap();
        let mut interval = 0;
        for step in 0..=50 {
            let x = f64::from(step) / 10.0;
            assert!((line.at(x, &mut interval) - (1.0 + 2.0 * x)).abs() < 1e-14);
        }
        assert_eq!((line.range(), line.max_slope()), ([0.0, 5.0], 2.0));
    }

    #[test]
    fn invalid_points_are_rejected() {
        assert_eq!(Pchip::new(vec![1.0], vec![1.0], Vec::new()), Err(PchipError::TooFew(1)));
        assert_eq!(Pchip::new(vec![0.0, 1.0, 1.0], vec![0.0; 3], Vec::new()), Err(PchipError::NotRising(2)));
        assert_eq!(Pchip::new(vec![0.0, f64::NAN], vec![0.0; 2], Vec::new()), Err(PchipError::NotRising(1)));
        assert_eq!(
            Pchip::new(vec![f64::NEG_INFINITY, 0.0], vec![0.0; 2], Vec::new()),
            Err(PchipError::NotRising(0))
        );
    }

    proptest! {
        #[test]
        fn rising_points_rise_between(steps in prop::collection::vec((1e-3..10.0, 1e-6..10.0), 2..40)) {
            let (mut x, mut y) = (vec![0.0], vec![0.0]);
            for (dx, dy) in &steps {
                x.push(x[x.len() - 1] + dx);
                y.push(y[y.len() - 1] + dy);
            }
            let end = x[x.len() - 1];
            let curve = Pchip::new(x, y, Vec::new()).unwrap();
            let (mut interval, mut before) = (0, f64::NEG_INFINITY);
            for step in 0..=1000 {
                let value = curve.at(end * f64::from(step) / 1000.0, &mut interval);
                prop_assert!(value >= before - 1e-9, "{before} {value}");
                before = value;
            }
        }
    }
}
