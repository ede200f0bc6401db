//! Changes of all members' mesh lines with wear, side by side for comparing a record with many at once.

use super::depths::DEPTHS;

/// Number of mesh harmonics that are simulated for a member.
pub const MESH_LINES: usize = 16;

/// Number of members side by side.
pub(crate) const LANES: usize = 16;

/// One number for each member of a block.
pub(crate) type Lanes = [f32; LANES];

/// Changes by block of [`LANES`] members, line and depth: natural logarithms of amplitudes over those of the
/// unworn pair; NaN where a line is not known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LineChanges {
    members: usize,
    values: Vec<Lanes>,
}

impl LineChanges {
    /// Creates the changes from the members' tables by line and depth. Unused lanes of the last block repeat
    /// the last member.
    pub(super) fn of(tables: &[Vec<f32>]) -> Self {
        let mut values = Vec::with_capacity(tables.len().div_ceil(LANES) * MESH_LINES * DEPTHS);
        for block in tables.chunks(LANES) {
            let table = |lane: usize| &block[lane.min(block.len() - 1)];
            values.extend(
                (0..MESH_LINES * DEPTHS).map(|at| std::array::from_fn::<_, LANES, _>(|lane| table(lane)[at])),
            );
        }
        Self { members: tables.len(), values }
    }

    /// Returns one member's table by line and depth.
    pub(super) fn table(&self, member: usize) -> Vec<f32> {
        let block = &self.values[member / LANES * MESH_LINES * DEPTHS..][..MESH_LINES * DEPTHS];
        block.iter().map(|lanes| lanes[member % LANES]).collect()
    }

    /// Returns all members' tables.
    pub(super) fn tables(&self) -> impl Iterator<Item = Vec<f32>> {
        (0..self.members).map(|member| self.table(member))
    }

    /// Returns the change of one line of one member at a depth.
    pub(super) fn at(&self, member: usize, line: usize, depth: usize) -> f32 {
        self.values[(member / LANES * MESH_LINES + line) * DEPTHS + depth][member % LANES]
    }

    /// Returns the changes of one line of a block's members, by depth.
    pub(super) fn block(&self, block: usize, line: usize) -> &[Lanes; DEPTHS] {
        let first = (block * MESH_LINES + line) * DEPTHS;
        self.values[first..].first_chunk().expect("a block has every line at every depth")
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
        for members in [1, 4, 16, 20] {
            let tables: Vec<Vec<f32>> = (0..members).map(table).collect();
            let changes = LineChanges::of(&tables);
            assert!(changes.tables().eq(tables.iter().cloned()));
            let last = members - 1;
            assert_eq!(changes.at(last, 3, 7), tables[last][3 * DEPTHS + 7]);
            assert_eq!(changes.block(last / LANES, 3)[7][last % LANES], tables[last][3 * DEPTHS + 7]);
            assert_eq!(changes.block(last / LANES, 3)[7][LANES - 1], tables[last][3 * DEPTHS + 7]);
        }
    }
}
