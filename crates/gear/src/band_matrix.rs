//! Symmetric positive definite band matrix and its Cholesky factor.

/// Lower triangle of a symmetric matrix whose entries vanish further than `half_band` from the diagonal, row
/// by row.
#[derive(Debug, Clone)]
pub(super) struct BandMatrix {
    size: usize,
    half_band: usize,
    rows: Vec<f64>,
}

impl BandMatrix {
    pub(super) fn zeros(size: usize, half_band: usize) -> Self {
        Self { size, half_band, rows: vec![0.0; size * (half_band + 1)] }
    }

    /// Adds to the entry of a row and a column at or before it, within the band.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.rows[row * (self.half_band + 1) + column + self.half_band - row] += value;
    }

    /// Entries of a row from `from` up to but without `to`.
    fn part(&self, row: usize, from: usize, to: usize) -> &[f64] {
        let start = row * (self.half_band + 1) + self.half_band - row;
        &self.rows[start + from..start + to]
    }

    /// Returns the Cholesky factor, or `None` if the matrix is not positive definite.
    pub(super) fn factor(mut self) -> Option<BandFactor> {
        // A row of the factor starts where the matrix's own row starts.
        let mut first = Vec::with_capacity(self.size);
        for row in 0..self.size {
            let least = row.saturating_sub(self.half_band);
            let own = self.part(row, least, row).iter().position(|value| *value != 0.0);
            let start = own.map_or(row, |own| least + own);
            first.push(start);
            for (column, column_start) in first.iter().enumerate().skip(start) {
                let from = start.max(*column_start);
                let products = dot(self.part(row, from, column), self.part(column, from, column));
                let rest = self.part(row, column, column + 1)[0] - products;
                let value = if column == row {
                    if rest <= 0.0 || rest.is_nan() {
                        return None;
                    }
                    rest.sqrt()
                } else {
                    rest / self.part(column, column, column + 1)[0]
                };
                self.rows[row * (self.half_band + 1) + column + self.half_band - row] = value;
            }
        }
        Some(BandFactor { lower: self, first })
    }
}

/// Scalar product in eight independent partial sums.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; 8];
    let (a_chunks, b_chunks) = (a.chunks_exact(8), b.chunks_exact(8));
    let rest: f64 = a_chunks.remainder().iter().zip(b_chunks.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in a_chunks.zip(b_chunks) {
        for (lane, (a, b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
            *lane += a * b;
        }
    }
    lanes.iter().sum::<f64>() + rest
}

/// Cholesky factor of a [`BandMatrix`].
#[derive(Debug, Clone)]
pub(super) struct BandFactor {
    lower: BandMatrix,
    /// Column of each row's first entry that may not vanish.
    first: Vec<usize>,
}

impl BandFactor {
    /// Solves for `count` right-hand sides in place: `values[row * count + side]`.
    pub(super) fn solve(&self, values: &mut [f64], count: usize) {
        let (size, half_band) = (self.lower.size, self.lower.half_band);
        // Rows before the first loaded one remain zero.
        let loaded = values.iter().position(|value| *value != 0.0).map_or(size, |place| place / count);
        for row in loaded..size {
            let first = self.first[row].max(loaded);
            let (before, rest) = values.split_at_mut(row * count);
            let target = &mut rest[..count];
            subtract(target, self.lower.part(row, first, row), &before[first * count..]);
            let diagonal = self.lower.part(row, row, row + 1)[0];
            target.iter_mut().for_each(|t| *t /= diagonal);
        }
        let mut factors = Vec::with_capacity(half_band);
        for row in (0..size).rev() {
            let (before, after) = values.split_at_mut((row + 1) * count);
            let target = &mut before[row * count..];
            factors.clear();
            let last = (row + half_band).min(size - 1);
            factors.extend((row + 1..=last).map(|below| self.lower.part(below, row, row + 1)[0]));
            subtract(target, &factors, after);
            let diagonal = self.lower.part(row, row, row + 1)[0];
            target.iter_mut().for_each(|t| *t /= diagonal);
        }
    }
}

/// Subtracts from `target` the sum of factors times rows; `rows` has one row of the target's length per
/// factor.
fn subtract(target: &mut [f64], factors: &[f64], rows: &[f64]) {
    let count = target.len();
    let (fours, rest) = factors.as_chunks::<4>();
    for (i, [a, b, c, d]) in fours.iter().enumerate() {
        let four = &rows[4 * i * count..][..4 * count];
        let (low, high) = four.split_at(2 * count);
        let ((one, two), (three, four)) = (low.split_at(count), high.split_at(count));
        for (t, (((one, two), three), four)) in
            target.iter_mut().zip(one.iter().zip(two).zip(three).zip(four))
        {
            *t -= (a * one + b * two) + (c * three + d * four);
        }
    }
    for (i, factor) in rest.iter().enumerate() {
        let row = &rows[(4 * fours.len() + i) * count..][..count];
        target.iter_mut().zip(row).for_each(|(t, value)| *t -= factor * value);
    }
}

#[cfg(test)]
mod tests {
    use super::BandMatrix;

    /// The second difference with fixed ends has the inverse min(i, j)·(n + 1 − max(i, j))/(n + 1).
    #[test]
    fn solves_the_second_difference() {
        let size = 9;
        let mut matrix = BandMatrix::zeros(size, 2);
        for i in 0..size {
            matrix.add(i, i, 2.0);
            if i > 0 {
                matrix.add(i, i - 1, -1.0);
            }
        }
        let factor = matrix.factor().unwrap();
        let mut values = vec![0.0; size * 2];
        values[3 * 2] = 1.0;
        values[8 * 2 + 1] = 1.0;
        factor.solve(&mut values, 2);
        for i in 0..size {
            for (side, j) in [3, 8].into_iter().enumerate() {
                let wanted = ((i.min(j) + 1) * (size - i.max(j))) as f64 / (size + 1) as f64;
                assert!((values[i * 2 + side] - wanted).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn rejects_indefinite_matrices() {
        let mut matrix = BandMatrix::zeros(2, 1);
        matrix.add(0, 0, 1.0);
        matrix.add(1, 0, 2.0);
        matrix.add(1, 1, 1.0);
        assert!(matrix.factor().is_none());
    }
}
