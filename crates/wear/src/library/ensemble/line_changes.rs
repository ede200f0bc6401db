//! Changes of all members' mesh lines with wear, side by side for comparing a record with many at once.

use super::depths::DEPTHS;

/// Number of mesh harmonics that are simulated for a member.
pub const MESH_LINES: usize = 16;

/// Number of members side by side.
pub(crate) const LANES: usize = 16;

/// One number for each member of a block.
pub(crate) type Lanes = [f32; LANES];

/// Changes by line and member of a block.
pub(crate) type DepthChanges = [Lanes; MESH_LINES];

/// Changes by block of members, depth and line: natural logarithms of amplitudes over those of the unworn
/// pair; NaN where a line is not known. A comparison of all members reads them in this order.
///
/// Consecutive members form groups of `variants`. A block has one variant of each of [`LANES`] groups, and
/// the blocks of all variants of these groups follow each other.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LineChanges {
    groups: usize,
    variants: usize,
    values: Vec<DepthChanges>,
}

impl LineChanges {
    /// Creates the changes from the members' tables by line and depth. Unused lanes of the last blocks repeat
    /// the last group.
    pub(super) fn of(tables: &[Vec<f32>], variants: usize) -> Self {
        let groups = tables.len() / variants;
        let mut changes = Self { groups, variants, values: Vec::new() };
        for block in 0..changes.blocks() {
            let tables: [&[f32]; LANES] =
                std::array::from_fn(|lane| &tables[changes.member(block, lane)][..]);
            let lanes = |line: usize, depth: usize| tables.map(|table| table[line * DEPTHS + depth]);
            let at_depth = |depth| -> DepthChanges { std::array::from_fn(|line| lanes(line, depth)) };
            changes.values.extend((0..DEPTHS).map(at_depth));
        }
        changes
    }

    /// Returns the number of blocks.
    pub(super) fn blocks(&self) -> usize {
        self.groups.div_ceil(LANES) * self.variants
    }

    /// Returns the member in a lane of a block.
    pub(super) fn member(&self, block: usize, lane: usize) -> usize {
        let group = (block / self.variants * LANES + lane).min(self.groups - 1);
        group * self.variants + block % self.variants
    }

    /// Returns a member's block and lane.
    pub(super) fn place(&self, member: usize) -> (usize, usize) {
        let (group, variant) = (member / self.variants, member % self.variants);
        (group / LANES * self.variants + variant, group % LANES)
    }

    /// Returns all members' tables by line and depth.
    pub(super) fn tables(&self) -> impl Iterator<Item = Vec<f32>> {
        let table = |member| {
            let at = |at: usize| self.at(member, at / DEPTHS, at % DEPTHS);
            (0..MESH_LINES * DEPTHS).map(at).collect()
        };
        (0..self.groups * self.variants).map(table)
    }

    /// Returns the change of one line of one member at a depth.
    pub(super) fn at(&self, member: usize, line: usize, depth: usize) -> f32 {
        let (block, lane) = self.place(member);
        self.block(block)[depth][line][lane]
    }

    /// Returns the changes of a block's members, by depth.
    pub(super) fn block(&self, block: usize) -> &[DepthChanges; DEPTHS] {
        self.values[block * DEPTHS..].first_chunk().expect("a block has every depth")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_recovered() {
        let table = |member: usize| -> Vec<f32> {
            (0..MESH_LINES * DEPTHS).map(|at| (member * 1000 + at) as f32).collect()
        };
        for (members, variants) in [(1, 1), (4, 4), (64, 4), (80, 4)] {
            let tables: Vec<Vec<f32>> = (0..members).map(table).collect();
            let changes = LineChanges::of(&tables, variants);
            assert!(changes.tables().eq(tables.iter().cloned()));
            let last = members - 1;
            let (block, lane) = changes.place(last);
            assert_eq!(changes.member(block, lane), last);
            for lane in [lane, LANES - 1] {
                assert_eq!(changes.block(block)[7][3][lane], tables[last][3 * DEPTHS + 7]);
            }
        }
    }

    #[test]
    fn a_block_has_one_variant_of_each_group() {
        let changes = LineChanges::of(&vec![vec![0.0; MESH_LINES * DEPTHS]; 80], 4);
        assert_eq!(changes.blocks(), 8);
        assert_eq!((changes.member(1, 0), changes.member(1, 1), changes.member(4, 3)), (1, 5, 76));
    }
}
