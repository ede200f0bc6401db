//! The pairs that a command's estimate is made with: kept ones, or simulated in front of the user.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use indicatif::ProgressBar;

use super::CliError;
use super::library::progress_bar;
use crate::gear::PairSpec;
use crate::library::{
    BuildControl, Ensemble, EnsembleSettings, GridSettings, LibraryCache, LibraryError, VARIANTS, ensemble_id,
};

/// Ensembles of so many members, in the `libraries` of a data folder.
pub(super) struct Ensembles {
    cache: LibraryCache,
    settings: EnsembleSettings,
}

impl Ensembles {
    pub(super) fn new(data_dir: &Path, members: usize) -> Self {
        Self { cache: LibraryCache::new(data_dir.join("libraries")), settings: EnsembleSettings { members } }
    }

    /// How many members a whole one has.
    pub(super) fn members(&self) -> usize {
        self.settings.members
    }

    /// The whole ensemble around a pair where it is kept, else its first members.
    pub(super) fn first(&self, pair: &PairSpec) -> Result<Ensemble, CliError> {
        let grid = GridSettings::default().for_pair(pair);
        let bar = progress_bar(grid.states as u64, "wear states");
        let progress = |done: usize, _| bar.set_position(done as u64);
        let library = self.cache.get_or_build(pair, &grid, &BuildControl::with_progress(&progress))?;
        bar.finish_and_clear();
        if let Some(whole) = self.cache.get_ensemble(&library, &self.settings)? {
            return Ok(whole);
        }
        let settings = self.settings.first();
        let bar = progress_bar(0, "first pairs like it");
        let progress = |done, all| follow(&bar, done, all);
        let first = Ensemble::build(library, &settings, &BuildControl::with_progress(&progress))?;
        bar.finish_and_clear();
        if self.is_whole(&first) && settings.members > 0 {
            self.cache.put_ensemble(&first)?;
        }
        Ok(first)
    }

    /// Whether these are all members.
    pub(super) fn is_whole(&self, ensemble: &Ensemble) -> bool {
        ensemble.id() == ensemble_id(ensemble.described().id(), &self.settings)
    }

    /// All members; they are kept.
    ///
    /// # Errors
    /// [`LibraryError::Cancelled`] once `interrupted` is true, and those of the file system.
    pub(super) fn whole(
        &self,
        first: &Ensemble,
        interrupted: Option<&AtomicBool>,
    ) -> Result<Ensemble, LibraryError> {
        let bar = progress_bar(0, "more pairs like it");
        let progress = |done, all| follow(&bar, done, all);
        let control = BuildControl::with_progress(&progress);
        let control = match interrupted {
            Some(interrupted) => control.cancelled_by(interrupted),
            None => control,
        };
        let whole = first.extended(&self.settings, &control)?;
        bar.finish_and_clear();
        self.cache.put_ensemble(&whole)?;
        Ok(whole)
    }

    /// The whole ensemble around a pair, simulated where it is not kept.
    pub(super) fn of(&self, pair: &PairSpec) -> Result<Arc<Ensemble>, CliError> {
        let first = self.first(pair)?;
        if self.is_whole(&first) { Ok(Arc::new(first)) } else { Ok(Arc::new(self.whole(&first, None)?)) }
    }
}

/// Shows how many of the groups that are simulated together are done, in pairs.
fn follow(bar: &ProgressBar, done: usize, all: usize) {
    bar.set_length((all * VARIANTS) as u64);
    bar.set_position((done * VARIANTS) as u64);
}
