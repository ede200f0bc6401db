//! The ensemble of gear pairs that a command estimates with: from the cache, or simulated with a progress
//! bar.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use indicatif::ProgressBar;

use super::library::progress_bar;
use crate::cli::{CliError, output};
use crate::gear::PairSpec;
use crate::library::{
    BuildControl, Ensemble, EnsembleSettings, GridSettings, LibraryCache, LibraryError, VARIANTS, ensemble_id,
};

/// Largest number of members: eight times the usual one.
const MAX_MEMBERS: usize = 10_240;

/// Parses the number of members.
pub(in crate::cli) fn parse_members(text: &str) -> Result<usize, String> {
    let members = text.parse().ok().filter(|members| *members <= MAX_MEMBERS);
    members.ok_or_else(|| format!("expected a number from 0 to {MAX_MEMBERS}"))
}

/// Ensembles with a given number of members, cached in the `libraries` of a data folder.
pub(in crate::cli) struct Ensembles {
    cache: LibraryCache,
    settings: EnsembleSettings,
}

impl Ensembles {
    pub(in crate::cli) fn new(data_dir: &Path, members: usize) -> Self {
        Self { cache: LibraryCache::new(data_dir.join("libraries")), settings: EnsembleSettings { members } }
    }

    /// Number of members of a complete ensemble.
    pub(in crate::cli) fn members(&self) -> usize {
        self.settings.members
    }

    /// Returns the complete ensemble around a pair if it is cached, otherwise its first members.
    ///
    /// # Errors
    /// As those of [`complete`](Self::complete).
    pub(in crate::cli) fn first(
        &self,
        pair: &PairSpec,
        interrupted: Option<&AtomicBool>,
    ) -> Result<Ensemble, LibraryError> {
        let grid = GridSettings::default().for_pair(pair);
        let bar = progress_bar(grid.states as u64, "wear states");
        let progress = |done: usize, _| bar.set_position(done as u64);
        let library = self.cache.get_or_build(pair, &grid, &control(&progress, interrupted))?;
        bar.finish_and_clear();
        if let Some(complete) = self.cache.get_ensemble(&library, &self.settings)? {
            return Ok(complete);
        }
        let settings = self.settings.first();
        let bar = progress_bar(0, "first ensemble members");
        let progress = |done, all| update_bar(&bar, done, all);
        let first = Ensemble::build(library, &settings, &control(&progress, interrupted))?;
        bar.finish_and_clear();
        if self.is_complete(&first) && settings.members > 0 {
            self.keep(&first);
        }
        Ok(first)
    }

    /// Whether the ensemble has all its members.
    pub(in crate::cli) fn is_complete(&self, ensemble: &Ensemble) -> bool {
        ensemble.id() == ensemble_id(ensemble.described().id(), &self.settings)
    }

    /// Simulates the remaining members and caches the ensemble.
    ///
    /// # Errors
    /// [`LibraryError::Cancelled`] once `interrupted` is true, and file system errors.
    pub(in crate::cli) fn complete(
        &self,
        first: &Ensemble,
        interrupted: Option<&AtomicBool>,
    ) -> Result<Ensemble, LibraryError> {
        let bar = progress_bar(0, "more ensemble members");
        let progress = |done, all| update_bar(&bar, done, all);
        let complete = first.extended(&self.settings, &control(&progress, interrupted))?;
        bar.finish_and_clear();
        self.keep(&complete);
        Ok(complete)
    }

    /// Adds an ensemble to the cache; one that cannot be kept is as good for this run.
    fn keep(&self, ensemble: &Ensemble) {
        if let Err(error) = self.cache.put_ensemble(ensemble) {
            output::print_stderr(&format!("warning: the next run simulates the ensemble again: {error}"));
        }
    }

    /// Returns the complete ensemble around a pair, simulated where it is not cached.
    pub(in crate::cli) fn of(&self, pair: &PairSpec) -> Result<Arc<Ensemble>, CliError> {
        let first = self.first(pair, None)?;
        if self.is_complete(&first) {
            Ok(Arc::new(first))
        } else {
            Ok(Arc::new(self.complete(&first, None)?))
        }
    }
}

fn control<'a>(
    progress: &'a (dyn Fn(usize, usize) + Sync),
    interrupted: Option<&'a AtomicBool>,
) -> BuildControl<'a> {
    let control = BuildControl::with_progress(progress);
    match interrupted {
        Some(interrupted) => control.cancelled_by(interrupted),
        None => control,
    }
}

/// Sets the progress bar in pairs; `done` and `all` count groups of [`VARIANTS`] pairs simulated together.
fn update_bar(bar: &ProgressBar, done: usize, all: usize) {
    bar.set_length((all * VARIANTS) as u64);
    bar.set_position((done * VARIANTS) as u64);
}
