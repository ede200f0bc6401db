//! Rebalancing: which partitions a worker releases or claims.
//!
//! Every worker computes this for itself from the rows in the store. Shares add up to all partitions, so
//! workers that read the same rows agree without a leader.

use std::cmp::Reverse;
use std::collections::BTreeSet;

use super::partition::PARTITIONS;
use crate::store::PartitionOwners;

/// The changes that bring a worker to its share.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Rebalance {
    /// Owned partitions for others.
    pub(super) release: Vec<u16>,
    /// Partitions without an owner.
    pub(super) claim: Vec<u16>,
}

impl Rebalance {
    /// Computes the changes of a worker, which is among the owners.
    pub(super) fn of(worker: &str, owners: &PartitionOwners) -> Self {
        let (count, total) = (owners.len().max(1), usize::from(PARTITIONS));
        // If the partitions cannot be divided evenly, those that own most keep one more.
        let mut ranked: Vec<_> = owners.iter().collect();
        ranked.sort_unstable_by_key(|(name, owned)| (Reverse(owned.len()), name.as_str()));
        let taken: BTreeSet<u16> = owners.values().flatten().copied().collect();
        let mut free = (0..PARTITIONS).filter(|partition| !taken.contains(partition));
        for (rank, (name, owned)) in ranked.into_iter().enumerate() {
            let share = total / count + usize::from(rank < total % count);
            // Each worker claims others than those ranked before it.
            let claim: Vec<u16> = free.by_ref().take(share.saturating_sub(owned.len())).collect();
            if name == worker {
                return Self { release: owned.iter().skip(share).copied().collect(), claim };
            }
        }
        Self::default()
    }
}

/// Counts the partitions that none of the workers owns.
pub(super) fn unowned<'a>(workers: impl IntoIterator<Item = &'a Vec<u16>>) -> u64 {
    let owned: BTreeSet<u16> =
        workers.into_iter().flatten().copied().filter(|partition| *partition < PARTITIONS).collect();
    u64::from(PARTITIONS) - owned.len() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn workers(count: u32) -> PartitionOwners {
        (0..count).map(|n| (format!("worker-{n}"), BTreeSet::new())).collect()
    }

    /// Lets every worker apply its changes; returns the number of partitions that were claimed. All workers
    /// read the same rows, or each one reads what those before it have changed.
    fn step(owners: &mut PartitionOwners, at_once: bool) -> usize {
        let (before, mut claimed) = (owners.clone(), 0);
        for name in before.keys() {
            let changes = Rebalance::of(name, if at_once { &before } else { owners });
            let taken: BTreeSet<u16> = owners.values().flatten().copied().collect();
            let owned = owners.get_mut(name).unwrap();
            for partition in changes.release {
                assert!(owned.remove(&partition));
            }
            for partition in changes.claim.iter().filter(|partition| !taken.contains(partition)) {
                owned.insert(*partition);
                claimed += 1;
            }
        }
        claimed
    }

    fn settle(owners: &mut PartitionOwners, at_once: bool) -> usize {
        let mut claimed = 0;
        for _ in 0..8 {
            claimed += step(owners, at_once);
        }
        claimed
    }

    #[track_caller]
    fn assert_fair(owners: &PartitionOwners) {
        let counts: Vec<usize> = owners.values().map(BTreeSet::len).collect();
        let (least, most) = (counts.iter().min().unwrap(), counts.iter().max().unwrap());
        assert!(most - least <= 1, "{counts:?}");
        assert_eq!(counts.iter().sum::<usize>(), usize::from(PARTITIONS), "{counts:?}");
        assert_eq!(
            unowned(&owners.values().map(|owned| owned.iter().copied().collect()).collect::<Vec<_>>()),
            0
        );
    }

    #[test]
    fn any_number_of_workers_shares_all_partitions() {
        for count in [1, 2, 3, 5, 7, 63, 64, 65, 100] {
            for at_once in [false, true] {
                let mut owners = workers(count);
                settle(&mut owners, at_once);
                assert_fair(&owners);
                assert_eq!(step(&mut owners, at_once), 0, "{count} workers keep what they own");
            }
        }
    }

    #[test]
    fn a_worker_that_joins_or_leaves_moves_only_its_share() {
        for count in 2..20 {
            let mut owners = workers(count);
            settle(&mut owners, true);
            // It sorts before all others, so every rank changes.
            owners.insert("joins".to_owned(), BTreeSet::new());
            let share = usize::from(PARTITIONS) / (count as usize + 1);
            assert_eq!(settle(&mut owners, true), share, "{count} workers and one more");
            assert_fair(&owners);
            let left = owners.remove("worker-1").unwrap();
            assert_eq!(settle(&mut owners, true), left.len(), "one of {count} leaves");
            assert_fair(&owners);
        }
    }

    #[test]
    fn partitions_without_an_owner_are_counted_once() {
        assert_eq!(unowned(&[]), u64::from(PARTITIONS));
        assert_eq!(unowned(&[vec![0, 1], vec![1, 2], vec![PARTITIONS]]), u64::from(PARTITIONS) - 3);
    }
}
