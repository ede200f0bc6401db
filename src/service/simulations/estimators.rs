//! The estimators in use: assets with the same fold key share one.

use std::collections::HashMap;
use std::sync::Arc;

use crate::asset::AssetId;
use crate::estimate::{ChannelEstimator, MissingLibrary};

/// An estimator with keys that identify all its inputs.
#[derive(Debug, Clone)]
pub(crate) struct KeyedEstimator {
    pub(crate) estimator: ChannelEstimator,
    /// A fold under another key has to start again.
    pub(crate) fold_key: String,
    /// Features under another key cannot be folded.
    pub(crate) feature_key: Arc<str>,
    /// Why it has no library; `None` if it has one.
    pub(super) lack: Option<MissingLibrary>,
}

impl KeyedEstimator {
    /// Whether it will be replaced once the asset's library is ready.
    pub(crate) fn awaits_library(&self) -> bool {
        self.lack == Some(MissingLibrary::Simulating)
    }

    /// Whether it has no library.
    pub(crate) fn is_without_library(&self) -> bool {
        self.lack.is_some()
    }
}

/// The estimators of all assets, by fold key.
#[derive(Debug, Default)]
pub(super) struct Estimators {
    by_key: HashMap<String, SharedEstimator>,
    /// The fold keys of each asset: that of its description, and those of the histories that are served until
    /// they are recomputed.
    keys: HashMap<AssetId, Vec<String>>,
}

#[derive(Debug)]
struct SharedEstimator {
    keyed: KeyedEstimator,
    /// Number of assets that use it.
    assets: usize,
}

impl Estimators {
    pub(super) fn get(&self, fold_key: &str) -> Option<&KeyedEstimator> {
        self.by_key.get(fold_key).map(|shared| &shared.keyed)
    }

    /// The estimator of an asset under a fold key; made if no asset uses it yet.
    pub(super) fn of(
        &mut self,
        asset: &AssetId,
        fold_key: &str,
        make: impl FnOnce() -> KeyedEstimator,
    ) -> KeyedEstimator {
        let keys = self.keys.entry(asset.clone()).or_default();
        let is_new = keys.iter().all(|key| key != fold_key);
        let shared = self.by_key.entry(fold_key.to_owned());
        let shared = shared.or_insert_with(|| SharedEstimator { keyed: make(), assets: 0 });
        if is_new {
            keys.push(fold_key.to_owned());
            shared.assets += 1;
        }
        shared.keyed.clone()
    }

    /// Drops the estimators of an asset under other keys than these, unless other assets use them.
    pub(super) fn keep_only(&mut self, asset: &AssetId, kept: &[String]) {
        let Some(keys) = self.keys.remove(asset) else { return };
        let (keys, dropped): (Vec<_>, Vec<_>) = keys.into_iter().partition(|key| kept.contains(key));
        for key in dropped {
            if let Some(shared) = self.by_key.get_mut(&key) {
                shared.assets -= 1;
                if shared.assets == 0 {
                    self.by_key.remove(&key);
                }
            }
        }
        if !keys.is_empty() {
            self.keys.insert(asset.clone(), keys);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::EstimatorSettings;

    #[test]
    fn an_estimator_is_dropped_with_the_last_asset_that_uses_it() {
        let settings = EstimatorSettings { baseline_records: 8, limit_um: None };
        let make = |key: &str| KeyedEstimator {
            estimator: ChannelEstimator::without_library(settings, MissingLibrary::NoMesh, Vec::new()),
            fold_key: key.to_owned(),
            feature_key: "features".into(),
            lack: None,
        };
        let asset = |name: &str| AssetId::new(name).unwrap();
        let mut estimators = Estimators::default();
        for (name, key) in [("a", "old"), ("a", "new"), ("a", "new"), ("b", "old")] {
            assert_eq!(estimators.of(&asset(name), key, || make(key)).fold_key, key);
        }
        estimators.keep_only(&asset("a"), &["new".to_owned()]);
        assert!(estimators.get("old").is_some() && estimators.get("new").is_some());
        estimators.keep_only(&asset("b"), &[]);
        assert!(estimators.get("old").is_none());
        estimators.keep_only(&asset("a"), &["new".to_owned()]);
        assert!(estimators.get("new").is_some());
        estimators.keep_only(&asset("a"), &[]);
        assert!(estimators.by_key.is_empty() && estimators.keys.is_empty());
    }
}
