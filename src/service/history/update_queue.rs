//! The queue of assets whose histories are to be brought up to date.

use std::collections::{HashSet, VecDeque};

use crate::asset::AssetId;

/// A queue of assets, each at most once.
#[derive(Debug, Default)]
pub(crate) struct UpdateQueue {
    order: VecDeque<AssetId>,
    /// The same assets as a set, since at a start the queue holds the whole fleet.
    assets: HashSet<AssetId>,
    /// Assets that are queued again later.
    waiting: HashSet<AssetId>,
    /// Whether a task is working on the queue.
    pub(crate) is_running: bool,
}

impl UpdateQueue {
    pub(crate) fn push(&mut self, asset: AssetId) {
        if self.assets.insert(asset.clone()) {
            self.order.push_back(asset);
        }
    }

    /// Removes and returns the next asset; if there is none, the task working on the queue ends.
    pub(crate) fn pop(&mut self) -> Option<AssetId> {
        let next = self.order.pop_front();
        self.is_running = next.is_some();
        self.assets.remove(next.as_ref()?);
        next
    }

    /// Records that an asset is to be queued again later; false if it is waiting already.
    pub(crate) fn begin_wait(&mut self, asset: &AssetId) -> bool {
        self.waiting.insert(asset.clone())
    }

    /// Records that an asset is queued again now.
    pub(crate) fn end_wait(&mut self, asset: &AssetId) {
        self.waiting.remove(asset);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.order.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_asset_is_queued_once_in_order() {
        let asset = |name: &str| AssetId::new(name).unwrap();
        let mut queue = UpdateQueue::default();
        for name in ["a", "b", "a", "c"] {
            queue.push(asset(name));
        }
        assert_eq!(queue.pop(), Some(asset("a")));
        queue.push(asset("a"));
        let rest: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(rest, [asset("b"), asset("c"), asset("a")]);
    }

    #[test]
    fn an_asset_waits_once_and_can_be_queued_meanwhile() {
        let asset = AssetId::new("a").unwrap();
        let mut queue = UpdateQueue::default();
        assert!(queue.begin_wait(&asset) && !queue.begin_wait(&asset));
        queue.push(asset.clone());
        assert_eq!(queue.pop(), Some(asset.clone()));
        queue.end_wait(&asset);
        assert!(queue.begin_wait(&asset));
    }
}
