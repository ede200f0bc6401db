//! Fixtures shared by the tests of this crate.

use super::{FlankWear, GearPair, PairSpec};

/// Returns the pair of Table 1 from its file.
pub(super) fn shen2022_spec() -> PairSpec {
    PairSpec::from_toml(include_str!("../../../fixtures/pairs/shen2022.toml")).unwrap()
}

/// Returns the pair of Table 1, resolved.
pub(super) fn shen2022() -> GearPair {
    shen2022_spec().resolve().unwrap()
}

/// Returns that pair with the typical nonuniform wear of Section 2.3: 0.05 mm at the root end, 0.035 mm at
/// the tip of both gears, zero at the pitch point.
pub(super) fn typical_wear() -> (GearPair, FlankWear) {
    let mut spec = shen2022_spec();
    (spec.wear.floor, spec.wear.tip_ratio, spec.wear.exponent) = (0.0, 0.7, 2.0);
    let pair = spec.resolve().unwrap();
    let wear = FlankWear::from_shape(&pair, 0.05).unwrap();
    (pair, wear)
}
