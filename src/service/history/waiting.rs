//! Assets that wait for their recomputation.

use std::collections::{HashSet, VecDeque};

use crate::asset::AssetId;

/// Assets in the order in which they are looked at, each once.
#[derive(Debug, Default)]
pub(crate) struct Waiting {
    order: VecDeque<AssetId>,
    /// The same ones: at a start that is the whole fleet.
    assets: HashSet<AssetId>,
    /// Somebody takes them out.
    pub(crate) is_running: bool,
}

impl Waiting {
    pub(crate) fn push(&mut self, asset: AssetId) {
        if self.assets.insert(asset.clone()) {
            self.order.push_back(asset);
        }
    }

    /// The next asset; where there is none, nobody takes them out any more.
    pub(crate) fn pop(&mut self) -> Option<AssetId> {
        let next = self.order.pop_front();
        self.is_running = next.is_some();
        self.assets.remove(next.as_ref()?);
        next
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.order.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_asset_waits_once_and_in_its_turn() {
        let asset = |name: &str| AssetId::new(name).unwrap();
        let mut waiting = Waiting::default();
        for name in ["a", "b", "a", "c"] {
            waiting.push(asset(name));
        }
        assert_eq!(waiting.pop(), Some(asset("a")));
        waiting.push(asset("a"));
        let rest: Vec<_> = std::iter::from_fn(|| waiting.pop()).collect();
        assert_eq!(rest, [asset("b"), asset("c"), asset("a")]);
    }
}
