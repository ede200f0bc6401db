//! Selects records of a trend by time range and operating bin.

use std::borrow::Cow;
use std::ops::Range;

use jiff::Timestamp;

use crate::asset::{AssetSpec, OperatingBin};
use crate::http::problem::Problem;
use crate::store::Trend;

/// Selected positions in a trend.
#[derive(Debug)]
pub(crate) struct Selection {
    range: Range<usize>,
    /// The selected positions within the range; all if `None`.
    some: Option<Vec<usize>>,
}

impl Selection {
    /// Selects the records that start at `from` or later and before `to`, optionally of one bin.
    pub(crate) fn of(
        trend: &Trend,
        from: Option<Timestamp>,
        to: Option<Timestamp>,
        bin: Option<&OperatingBin>,
    ) -> Self {
        let range = trend.range(from, to);
        let some = bin.map(|bin| range.clone().filter(|n| holds(bin, trend, *n)).collect());
        Self { range, some }
    }

    /// Keeps only the records whose position in the trend satisfies `holds`.
    pub(crate) fn only(self, holds: impl Fn(usize) -> bool) -> Self {
        let all = 0..self.len();
        let some = all.map(|n| self.position(n)).filter(|n| holds(*n)).collect();
        Self { range: self.range, some: Some(some) }
    }

    pub(crate) fn len(&self) -> usize {
        self.some.as_ref().map_or(self.range.len(), Vec::len)
    }

    /// The position in the trend of the `n`-th selected record.
    pub(crate) fn position(&self, n: usize) -> usize {
        self.some.as_ref().map_or(self.range.start + n, |some| some[n])
    }

    /// A column of the trend for the selected records.
    pub(crate) fn column<'a, T: Copy>(&self, whole: &'a [T]) -> Cow<'a, [T]> {
        match &self.some {
            None => Cow::Borrowed(&whole[self.range.clone()]),
            Some(some) => some.iter().map(|n| whole[*n]).collect(),
        }
    }
}

/// The requested operating bin of an asset.
pub(crate) fn requested_bin(spec: &AssetSpec, name: Option<&str>) -> Result<Option<OperatingBin>, Problem> {
    let Some(name) = name else { return Ok(None) };
    let bin = spec.operating_bins.iter().find(|bin| bin.name == name);
    let unknown = || Problem::query("operating_bin", name, "the name of one of the asset's operating_bins");
    bin.cloned().map(Some).ok_or_else(unknown)
}

/// The bin of a trend's record; `None` if it is in none.
pub(crate) fn bin_of<'a>(bins: &'a [OperatingBin], trend: &Trend, position: usize) -> Option<&'a str> {
    bins.iter().find(|bin| holds(bin, trend, position)).map(|bin| bin.name.as_str())
}

fn holds(bin: &OperatingBin, trend: &Trend, position: usize) -> bool {
    let known = |value: f64| value.is_finite().then_some(value);
    bin.holds(known(trend.shaft_speed_hz[position]), known(trend.torque_nm[position]))
}
