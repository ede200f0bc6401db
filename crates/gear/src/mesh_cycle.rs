//! One mesh period of a pair: the pairs of teeth in contact, their total stiffness, and the position of the
//! driven gear.

use super::error::within;
use super::pair_curve::PairCurve;
use super::{ContactRule, ElasticBodies, FlankWear, GearError, GearPair, root};

/// Resolution of a mesh period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Resolution {
    /// For a single pair.
    Fine,
    /// For comparisons of many pairs: four times as fast. The first ten mesh harmonics of the response are
    /// within 1 % of those of the fine resolution.
    Coarse,
}

impl Resolution {
    /// Number of cells of the mesh period in which a change of the pairs in contact is searched, and of the
    /// smooth parts between two changes.
    fn cells(self) -> usize {
        match self {
            Self::Fine => 1024,
            Self::Coarse => 256,
        }
    }

    /// Smallest number of cells of the mesh period under load. A kink within a cell is rounded off; with half
    /// of the fine cells this reduces a worn pair's response by 0.12 %.
    pub(super) fn loaded_cells(self) -> usize {
        match self {
            Self::Fine => 2000,
            Self::Coarse => 500,
        }
    }
}

/// Accuracy of the position of a change in mesh periods.
const POSITION_TOLERANCE: f64 = 1e-12;

/// One mesh period from the nominal start of contact of the driving tooth pair, including that point and
/// excluding the period's end.
///
/// Multi-tooth rule (Section 3.2.2): pair n is the single pair shifted by (n − 1)·2π/z, Eq. (28). The pair
/// with the largest φ₂ is in contact, and so is every pair whose φ₂ is smaller by less than the threshold;
/// their stiffnesses add, Eq. (29).
#[derive(Debug, Clone, PartialEq)]
pub struct MeshCycle {
    /// φ₁ in rad of the driving tooth that starts its contact at the first point.
    pub phi1_rad: Vec<f64>,
    /// φ₂ in rad of the driven tooth that mates with that driving tooth: the leading pair's φ₂, counted back
    /// to it.
    pub phi2_rad: Vec<f64>,
    /// Mesh stiffness k in N/m.
    pub stiffness_n_per_m: Vec<f64>,
    /// e_wear in rad of the driven gear, Eq. (31): φ₁ R_b1/R_b2 − φ₂, less its constant for perfect flanks (a
    /// tooth's centre line of one gear faces that of a space of the other: −π/z₂ without backlash). Positive
    /// if the driven gear lags.
    pub uste_rad: Vec<f64>,
    /// Number of pairs of teeth that carry load.
    pub pairs_in_contact: Vec<u32>,
    /// The same period in pieces without jumps.
    pub(super) pieces: Vec<CyclePiece>,
}

/// A piece of the mesh period during which the same pairs carry load.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CyclePiece {
    /// Start in mesh periods.
    pub(super) start: f64,
    /// End in mesh periods.
    pub(super) end: f64,
    /// Stiffness in N/m at equidistant positions, including both ends.
    pub(super) stiffness_n_per_m: Vec<f64>,
    /// e_wear in rad at the same positions.
    pub(super) uste_rad: Vec<f64>,
}

/// The pairs in contact at one rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Carrying {
    /// Bit n is set if the pair n periods ahead of the entering one carries load.
    pairs: u32,
    leader: usize,
    phi2_rad: f64,
    stiffness_n_per_m: f64,
}

/// Lead in rad below which two pairs count as level: rounding of perfect flanks.
const TIE_RAD: f64 = 1e-11;
/// Lead in rad of worn over perfect flanks that is due to rounding and interpolation.
const LEAD_ROUNDING_RAD: f64 = 1e-6;
/// Largest plausible lag on the base circle over the sum of both depths: across the flank the depths count
/// less than along Y, on curved flanks slightly more.
const LAG_SLACK: f64 = 1.2;

/// All pairs of teeth of the mesh.
pub(super) struct Mesh<'a> {
    pair: &'a GearPair,
    pub(super) curve: PairCurve,
    /// φ₁ R_b1/R_b2 − φ₂ of perfect flanks.
    perfect_lag_rad: f64,
    /// Largest number of pairs that can touch at once.
    max_pairs: usize,
    /// Largest lag in rad that the wear can cause between two teeth.
    max_lag_rad: f64,
}

impl MeshCycle {
    /// Computes one mesh period at `points` evenly spaced rotations by the pair's contact rule. For loaded
    /// contact at several torques, [`MeshCycle::loaded`] with the same [`ElasticBodies`] is faster.
    ///
    /// # Errors
    /// Those of [`MeshCycle::loaded`] and [`ElasticBodies::new`] for loaded contact, else
    /// [`GearError::Field`] for fewer than 2 or more than 1 000 000 points; [`GearError::NoContact`] if wear
    /// leaves a part of the period without contact.
    pub fn compute(pair: &GearPair, wear: &FlankWear, points: usize) -> Result<Self, GearError> {
        if pair.spec.dynamics.contact == ContactRule::Loaded {
            return Self::loaded(pair, &ElasticBodies::new(pair, wear)?, wear, points);
        }
        Self::by_threshold(pair, wear, points, Resolution::Fine)
    }

    /// Like [`MeshCycle::compute`], or [`MeshCycle::loaded`] if `bodies` are given, at a coarse resolution:
    /// the first ten mesh harmonics of the response are within 1 % of those of the fine one.
    ///
    /// # Errors
    /// Those of the two methods.
    pub fn coarse(
        pair: &GearPair,
        bodies: Option<&ElasticBodies>,
        wear: &FlankWear,
        points: usize,
    ) -> Result<Self, GearError> {
        match bodies {
            Some(bodies) => Self::loaded_at(pair, bodies, wear, points, Resolution::Coarse),
            None => Self::by_threshold(pair, wear, points, Resolution::Coarse),
        }
    }

    pub(super) fn with_capacity(points: usize) -> Self {
        Self {
            phi1_rad: Vec::with_capacity(points),
            phi2_rad: Vec::with_capacity(points),
            stiffness_n_per_m: Vec::with_capacity(points),
            uste_rad: Vec::with_capacity(points),
            pairs_in_contact: Vec::with_capacity(points),
            pieces: Vec::new(),
        }
    }

    fn by_threshold(
        pair: &GearPair,
        wear: &FlankWear,
        points: usize,
        resolution: Resolution,
    ) -> Result<Self, GearError> {
        within("points", points as f64, 2.0, 1e6)?;
        let mesh = Mesh::new(pair, wear)?;
        let (start, pitch) = (pair.start_of_contact_rad(), pair.gears[0].pitch_angle_rad());
        let mut cycle = Self::with_capacity(points);
        cycle.pieces = mesh.pieces(resolution.cells())?;
        for i in 0..points {
            let phi1 = start + pitch * (i as f64 / points as f64);
            let carrying = mesh.carrying(phi1)?;
            cycle.phi1_rad.push(phi1);
            cycle.phi2_rad.push(carrying.phi2_rad);
            cycle.stiffness_n_per_m.push(carrying.stiffness_n_per_m);
            cycle.uste_rad.push(mesh.lag(phi1, carrying.phi2_rad));
            cycle.pairs_in_contact.push(carrying.pairs.count_ones());
        }
        Ok(cycle)
    }

    /// Returns the mean of k over the mesh period in N/m.
    pub fn mean_stiffness_n_per_m(&self) -> f64 {
        self.pieces.iter().map(|piece| (piece.end - piece.start) * piece.mean_stiffness()).sum()
    }
}

impl CyclePiece {
    /// Returns the mean stiffness by the trapezoidal rule.
    fn mean_stiffness(&self) -> f64 {
        let ends =
            0.5 * (self.stiffness_n_per_m[0] + self.stiffness_n_per_m[self.stiffness_n_per_m.len() - 1]);
        let inner: f64 = self.stiffness_n_per_m[1..self.stiffness_n_per_m.len() - 1].iter().sum();
        (ends + inner) / (self.stiffness_n_per_m.len() - 1) as f64
    }
}

impl<'a> Mesh<'a> {
    pub(super) fn new(pair: &'a GearPair, wear: &FlankWear) -> Result<Self, GearError> {
        let curve = PairCurve::new(pair, wear)?;
        let periods = (curve.range().1 - pair.start_of_contact_rad()) / pair.gears[0].pitch_angle_rad();
        Ok(Self {
            pair,
            perfect_lag_rad: pair.perfect_lag_rad(),
            max_pairs: (periods.ceil() as usize + 1).min(30),
            max_lag_rad: LAG_SLACK * wear.greatest_depth_mm(pair).iter().sum::<f64>()
                / pair.gears[1].base_radius_mm
                + TIE_RAD,
            curve,
        })
    }

    /// Returns the share of the load, by stiffness, on the pair of teeth whose driving tooth is at φ₁.
    pub(super) fn share(&self, phi1: f64) -> Result<f64, GearError> {
        let pitch = self.pair.gears[0].pitch_angle_rad();
        let ahead = ((phi1 - self.pair.start_of_contact_rad()) / pitch)
            .floor()
            .clamp(-1.0, self.max_pairs as f64 - 1.0);
        let carrying = self.carrying(phi1 - ahead * pitch)?;
        let carries = carrying.pairs >> (ahead as i32 + 1) & 1 == 1;
        let own = self.curve.at(phi1).filter(|_| carries).map_or(0.0, |(_, stiffness)| stiffness);
        Ok(own / carrying.stiffness_n_per_m)
    }

    /// Returns the pairs in contact at φ₁ of the entering tooth pair.
    fn carrying(&self, phi1: f64) -> Result<Carrying, GearError> {
        let pitches = self.pair.gears.each_ref().map(|gear| gear.pitch_angle_rad());
        // A worn pair may start before the nominal start: the following pair is number 0.
        let mut contacts: [Option<(f64, f64)>; 32] = [None; 32];
        let mut leader = None;
        for (n, contact) in contacts.iter_mut().enumerate().take(self.max_pairs + 1) {
            let ahead = n as f64 - 1.0;
            *contact =
                self.curve.at(phi1 + ahead * pitches[0]).map(|(phi2, k)| (phi2 - ahead * pitches[1], k));
            if let Some((phi2, _)) = contact
                && leader.is_none_or(|(_, most)| *phi2 > most + TIE_RAD)
            {
                leader = Some((n, *phi2));
            }
        }
        // Less material cannot advance the driven gear, and a pair that lags by more than both depths leaves
        // another one in contact. Tables with steps cause edge contact, which the relationship does not
        // model.
        let plausible_lags = -LEAD_ROUNDING_RAD..=self.max_lag_rad;
        let Some((leader, phi2_rad)) =
            leader.filter(|(_, phi2)| plausible_lags.contains(&self.lag(phi1, *phi2)))
        else {
            return Err(GearError::NoContact { phi1_rad: phi1 });
        };
        let threshold = self.pair.spec.dynamics.contact_threshold_rad;
        let mut carrying = Carrying { pairs: 0, leader, phi2_rad, stiffness_n_per_m: 0.0 };
        for (n, contact) in contacts.iter().enumerate() {
            if let Some((phi2, stiffness)) = contact
                && phi2_rad - phi2 < threshold
            {
                carrying.pairs |= 1 << n;
                carrying.stiffness_n_per_m += stiffness;
            }
        }
        Ok(carrying)
    }

    /// Cuts the period where the pairs in contact or the leader change.
    fn pieces(&self, cells: usize) -> Result<Vec<CyclePiece>, GearError> {
        let key = |position: f64| {
            self.carrying(self.phi1_at(position)).map(|carrying| (carrying.pairs, carrying.leader))
        };
        let mut cuts = vec![0.0];
        // Evaluated in the cells' middles, so that rounding of a change at the period's ends does not count
        // as one.
        let mut before = (0.0, key(1e-9)?);
        for cell in 0..=cells {
            let position = ((cell as f64 + 0.5) / cells as f64).min(1.0 - 1e-9);
            let after = (position, key(position)?);
            while before.1 != after.1 {
                // Bisection on the key finds the first change; a second one in the same cell is found from
                // there.
                let differs =
                    |position: f64| key(position).map_or(1.0, |at| if at == before.1 { -1.0 } else { 1.0 });
                let cut = root::find(differs, (before.0, -1.0), (after.0, 1.0), POSITION_TOLERANCE);
                cuts.push(cut);
                before =
                    (cut + 2.0 * POSITION_TOLERANCE, key((cut + 4.0 * POSITION_TOLERANCE).min(after.0))?);
                if cuts.len() > cells {
                    break;
                }
            }
            before = after;
        }
        cuts.push(1.0);
        cuts.windows(2)
            .filter(|two| two[1] - two[0] > 1e-9)
            .map(|two| self.piece(two[0], two[1], cells))
            .collect()
    }

    fn piece(&self, start: f64, end: f64, cells: usize) -> Result<CyclePiece, GearError> {
        let count = ((end - start) * cells as f64).ceil() as usize + 1;
        let mut piece = CyclePiece {
            start,
            end,
            stiffness_n_per_m: Vec::with_capacity(count + 1),
            uste_rad: Vec::with_capacity(count + 1),
        };
        for i in 0..=count {
            // The ends belong to this piece: slightly inside of them, where no other pair carries load yet.
            let inside = (i as f64 / count as f64).clamp(1e-6 / count as f64, 1.0 - 1e-6 / count as f64);
            let phi1 = self.phi1_at(start + (end - start) * inside);
            let carrying = self.carrying(phi1)?;
            piece.stiffness_n_per_m.push(carrying.stiffness_n_per_m);
            piece.uste_rad.push(self.lag(phi1, carrying.phi2_rad));
        }
        Ok(piece)
    }

    /// Returns e_wear in rad, Eq. (31).
    fn lag(&self, phi1: f64, phi2: f64) -> f64 {
        self.pair.gears[0].base_radius_mm / self.pair.gears[1].base_radius_mm * phi1
            - phi2
            - self.perfect_lag_rad
    }

    /// Returns φ₁ in rad at a position in mesh periods.
    fn phi1_at(&self, position: f64) -> f64 {
        self.pair.start_of_contact_rad() + self.pair.gears[0].pitch_angle_rad() * position
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{shen2022, shen2022_spec, typical_wear};
    use super::{Mesh, MeshCycle};
    use crate::FlankWear;

    #[test]
    fn perfect_flanks_carry_in_twos_for_the_contact_ratio_and_have_no_error() {
        let pair = shen2022();
        let cycle = MeshCycle::compute(&pair, &FlankWear::none(), 10_000).unwrap();
        let twos = cycle.pairs_in_contact.iter().filter(|pairs| **pairs == 2).count();
        assert!(cycle.pairs_in_contact.iter().all(|pairs| *pairs == 1 || *pairs == 2));
        // Contact ratio 1.61140: 0.61140 of the period has two pairs.
        assert!((twos as f64 / 1e4 - 0.6114).abs() < 2e-4, "{twos}");
        assert!(cycle.uste_rad.iter().all(|lag| lag.abs() < 1e-12));
        assert_eq!(cycle.pieces.len(), 2);
        assert!((cycle.phi1_rad[0] + 0.277_624_056).abs() < 1e-9);
    }

    #[test]
    fn pieces_join_without_bridging_a_jump() {
        let (pair, wear) = typical_wear();
        let mesh = Mesh::new(&pair, &wear).unwrap();
        let cycle = MeshCycle::compute(&pair, &wear, 4000).unwrap();
        let pieces = &cycle.pieces;
        assert_eq!((pieces[0].start, pieces[pieces.len() - 1].end), (0.0, 1.0));
        assert!(pieces.windows(2).all(|two| (two[0].end - two[1].start).abs() < 1e-9));
        for piece in pieces {
            let count = piece.uste_rad.len() - 1;
            for i in 0..count {
                let middle = piece.start + (piece.end - piece.start) * (i as f64 + 0.5) / count as f64;
                let exact = mesh.carrying(mesh.phi1_at(middle)).unwrap();
                let stiffness = 0.5 * (piece.stiffness_n_per_m[i] + piece.stiffness_n_per_m[i + 1]);
                assert!(
                    (stiffness / exact.stiffness_n_per_m - 1.0).abs() < 1e-5,
                    "{stiffness} {}",
                    exact.stiffness_n_per_m
                );
                let lag = 0.5 * (piece.uste_rad[i] + piece.uste_rad[i + 1]);
                assert!((lag - mesh.lag(mesh.phi1_at(middle), exact.phi2_rad)).abs() < 1e-8);
            }
        }
        // The next period goes on where this one ends.
        let (first, last) = (&pieces[0], &pieces[pieces.len() - 1]);
        assert!((first.uste_rad[0] - last.uste_rad[last.uste_rad.len() - 1]).abs() < 1e-8);
        assert!(
            (first.stiffness_n_per_m[0] / last.stiffness_n_per_m[last.stiffness_n_per_m.len() - 1] - 1.0)
                .abs()
                < 1e-4
        );
    }

    #[test]
    fn wear_shortens_double_contact_and_grows_the_error_but_hardly_changes_the_stiffness() {
        // Figs. 15 and 18.
        let pair = shen2022();
        let at =
            |depth| MeshCycle::compute(&pair, &FlankWear::from_shape(&pair, depth).unwrap(), 2000).unwrap();
        let cycles = [0.0, 0.05, 0.1, 0.2].map(at);
        let doubles =
            cycles.each_ref().map(|cycle| cycle.pairs_in_contact.iter().filter(|pairs| **pairs == 2).count());
        assert!(doubles.windows(2).all(|two| two[1] < two[0]), "{doubles:?}");
        let swing = |cycle: &MeshCycle| {
            cycle.uste_rad.iter().copied().fold(f64::MIN, f64::max)
                - cycle.uste_rad.iter().copied().fold(f64::MAX, f64::min)
        };
        assert!(cycles.windows(2).all(|two| swing(&two[1]) > swing(&two[0])));
        let most = |cycle: &MeshCycle, pairs| {
            let stiffness = cycle.stiffness_n_per_m.iter().zip(&cycle.pairs_in_contact);
            stiffness.filter(|(_, at)| **at == pairs).map(|(k, _)| *k).fold(0.0, f64::max)
        };
        assert!((most(&cycles[3], 1) / most(&cycles[0], 1) - 1.0).abs() < 0.03);
        // The driven gear of worn flanks lags.
        assert!(cycles[1].uste_rad.iter().all(|lag| *lag > 0.0));
    }

    #[test]
    fn high_contact_ratio_carries_in_threes() {
        let mut spec = shen2022_spec();
        spec.geometry.teeth = [60, 70];
        spec.geometry.pressure_angle_deg = 17.5;
        spec.geometry.addendum = [1.3, 1.3];
        spec.geometry.dedendum = [1.55, 1.55];
        spec.geometry.centre_distance_mm = None;
        let pair = spec.resolve().unwrap();
        assert!(pair.contact_ratio() > 2.0);
        let cycle = MeshCycle::compute(&pair, &FlankWear::none(), 1000).unwrap();
        let mean = cycle.pairs_in_contact.iter().sum::<u32>() as f64 / 1000.0;
        assert!((mean - pair.contact_ratio()).abs() < 2e-3, "{mean}");
    }

    #[test]
    fn deep_hollows_carry_load_over_the_whole_period() {
        let pair = shen2022();
        // Flanks hollowed by 1.5 mm around the pitch point: contact hops from one side of the hollow to the
        // other.
        let table = "gear,radius_mm,depth_um\n1,69,0\n1,72,1500\n1,76,0\n2,75,0\n2,78,1500\n2,82,0\n";
        let wear = FlankWear::from_table_csv(&pair, table).unwrap();
        let cycle = MeshCycle::compute(&pair, &wear, 500).unwrap();
        assert!(cycle.pairs_in_contact.iter().all(|pairs| (1..=2).contains(pairs)));
        assert!(cycle.stiffness_n_per_m.iter().all(|stiffness| (1e8..1.5e9).contains(stiffness)));
        // Less material never pushes the driven gear further; where the hollow is not met the lag is that of
        // perfect flanks.
        assert!(
            cycle.uste_rad.iter().all(|lag| (-1e-9..0.1).contains(lag)),
            "{:?}",
            cycle.uste_rad.iter().copied().fold(f64::MAX, f64::min)
        );
    }

    #[test]
    fn numbers_of_points_are_limited() {
        let pair = shen2022();
        for points in [0, 1, 2_000_000] {
            assert!(
                MeshCycle::compute(&pair, &FlankWear::none(), points)
                    .unwrap_err()
                    .to_string()
                    .starts_with("points")
            );
        }
    }
}
