//! A simulated disk that fails at random, stops in the middle of an operation, and loses unsynced writes.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use flankwatch::store::Disk;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::sync::watch;

/// A rename or removal that a crash may undo, as the folder has not been synced since.
#[derive(Debug)]
struct Change {
    folder: PathBuf,
    path: PathBuf,
    /// The previous content of the path.
    before: Before,
}

#[derive(Debug)]
enum Before {
    Nothing,
    File(Vec<u8>),
}

#[derive(Debug)]
struct State {
    random: ChaCha8Rng,
    /// Probability that an operation fails.
    failing: f64,
    /// Number of operations until the disk stops.
    left: Option<u32>,
    is_dead: watch::Sender<bool>,
    unsynced: Vec<Change>,
    /// The database's log, which is not on this disk.
    log: PathBuf,
    /// The log when everything stopped: whatever was done here because of a commit came after it.
    log_at_end: Vec<u8>,
}

/// Works on a real folder and tracks what a crash could undo.
#[derive(Debug)]
pub(crate) struct ForgetfulDisk {
    state: Mutex<State>,
}

impl ForgetfulDisk {
    pub(crate) fn new(seed: u64, log: PathBuf) -> Self {
        Self {
            state: Mutex::new(State {
                random: ChaCha8Rng::seed_from_u64(seed),
                failing: 0.0,
                left: None,
                is_dead: watch::Sender::new(false),
                unsynced: Vec::new(),
                log,
                log_at_end: Vec::new(),
            }),
        }
    }

    /// Sets the probability that an operation fails.
    pub(crate) fn fail(&self, likelihood: f64) {
        self.state().failing = likelihood;
    }

    /// Stops the disk in the middle of an operation, after this many.
    pub(crate) fn stop_after(&self, operations: u32) {
        self.state().left = Some(operations);
    }

    /// Stops the disk.
    pub(crate) fn stop(&self) {
        self.state().end();
    }

    /// The database's log as it was when everything stopped. What is in it may have been answered, or may be
    /// what something here rests on; what came later may not.
    pub(crate) fn log_at_end(&self) -> Vec<u8> {
        self.state().log_at_end.clone()
    }

    pub(crate) fn is_stopped(&self) -> bool {
        *self.state().is_dead.borrow()
    }

    /// Waits for `work`; returns `None` if the disk stops first.
    pub(crate) async fn unless_stopped<T>(&self, work: impl Future<Output = T>) -> Option<T> {
        let mut stopped = self.state().is_dead.subscribe();
        tokio::select! {
            done = work => Some(done),
            _ = stopped.wait_for(|is_dead| *is_dead) => None,
        }
    }

    /// Undoes some unsynced changes in a copy of a folder: in each folder the latest ones.
    pub(crate) fn forget(&self, folder: &Path, copy: &Path) {
        let mut state = self.state();
        let changes = std::mem::take(&mut state.unsynced);
        let mut folders: Vec<PathBuf> = changes.iter().map(|change| change.folder.clone()).collect();
        folders.sort_unstable();
        folders.dedup();
        for of in folders {
            let mine: Vec<&Change> = changes.iter().filter(|change| change.folder == of).collect();
            let kept = state.random.random_range(0..=mine.len());
            for change in mine[kept..].iter().rev() {
                let path = copy.join(change.path.strip_prefix(folder).unwrap());
                let is_there = path.parent().is_some_and(Path::is_dir);
                match &change.before {
                    Before::Nothing if path.is_dir() => fs::remove_dir_all(&path).unwrap(),
                    Before::Nothing => drop(fs::remove_file(&path)),
                    Before::File(bytes) if is_there => fs::write(&path, bytes).unwrap(),
                    // The changes of its folder are lost too.
                    Before::File(_) => {}
                }
            }
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }

    /// Decides whether the next operation succeeds; returns the error if it fails.
    fn next(&self) -> Result<MutexGuard<'_, State>, (MutexGuard<'_, State>, io::Error)> {
        let mut state = self.state();
        if *state.is_dead.borrow() {
            return Err((state, io::Error::other("the disk has stopped")));
        }
        match &mut state.left {
            Some(0) => {
                state.end();
                return Err((state, io::Error::other("the disk stops")));
            }
            Some(left) => *left -= 1,
            None => {}
        }
        let failing = state.failing;
        if failing > 0.0 && state.random.random_bool(failing) {
            let kind =
                if state.random.random_bool(0.5) { io::ErrorKind::StorageFull } else { io::ErrorKind::Other };
            return Err((state, io::Error::new(kind, "the disk fails")));
        }
        Ok(state)
    }
}

impl State {
    fn end(&mut self) {
        if !self.is_dead.send_replace(true) {
            self.log_at_end = fs::read(&self.log).unwrap_or_default();
        }
    }

    /// What a failed write of these bytes leaves: a part, any part of which may be zeros.
    fn part(&mut self, bytes: &[u8]) -> Vec<u8> {
        let length = self.random.random_range(0..=bytes.len());
        let mut part = bytes[..length].to_vec();
        if self.random.random_bool(0.3) {
            let zeros = self.random.random_range(0..=length);
            part[zeros..].fill(0);
        }
        part
    }

    fn record(&mut self, path: &Path, before: Before) {
        let folder = path.parent().unwrap().to_path_buf();
        self.unsynced.push(Change { folder, path: path.to_path_buf(), before });
    }
}

/// Whether the disk had stopped before the operation that failed.
fn was_stopped(error: &io::Error) -> bool {
    error.to_string().contains("has stopped")
}

fn what_is_at(path: &Path) -> Before {
    fs::read(path).map_or(Before::Nothing, Before::File)
}

impl Disk for ForgetfulDisk {
    fn create_folder(&self, path: &Path) -> io::Result<()> {
        let mut state = self.next().map_err(|(_, error)| error)?;
        let missing: Vec<&Path> = path.ancestors().take_while(|path| !path.exists()).collect();
        for path in missing.into_iter().rev() {
            fs::create_dir(path)?;
            state.record(path, Before::Nothing);
        }
        Ok(())
    }

    fn write_synced(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        match self.next() {
            Ok(mut state) => {
                let before = what_is_at(path);
                fs::write(path, bytes)?;
                state.record(path, before);
                Ok(())
            }
            Err((mut state, error)) => {
                if !was_stopped(&error)
                    && let Ok(()) = fs::write(path, state.part(bytes))
                {
                    state.record(path, Before::Nothing);
                }
                Err(error)
            }
        }
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let _state = self.next().map_err(|(_, error)| error)?;
        fs::read(path)
    }

    fn open(&self, path: &Path) -> io::Result<File> {
        let _state = self.next().map_err(|(_, error)| error)?;
        File::open(path)
    }

    fn create_file(&self, path: &Path) -> io::Result<File> {
        let mut state = self.next().map_err(|(_, error)| error)?;
        let file = File::options().append(true).create_new(true).open(path)?;
        state.record(path, Before::Nothing);
        Ok(file)
    }

    fn append_synced(&self, mut file: &File, bytes: &[u8]) -> io::Result<()> {
        match self.next() {
            Ok(_state) => file.write_all(bytes),
            Err((_, error)) if was_stopped(&error) => Err(error),
            Err((mut state, error)) => file.write_all(&state.part(bytes)).and(Err(error)),
        }
    }

    fn cut_file(&self, file: &File, bytes: u64) -> io::Result<()> {
        let _state = self.next().map_err(|(_, error)| error)?;
        file.set_len(bytes)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.next().map_err(|(_, error)| error)?;
        let (moved, replaced) = (what_is_at(from), what_is_at(to));
        fs::rename(from, to)?;
        // Each folder is synced by itself: a crash may leave the file under both names, or under none.
        state.record(from, moved);
        state.record(to, replaced);
        Ok(())
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.next().map_err(|(_, error)| error)?;
        fs::hard_link(from, to)?;
        state.record(to, Before::Nothing);
        Ok(())
    }

    fn remove_file(&self, path: &Path) -> io::Result<()> {
        let mut state = self.next().map_err(|(_, error)| error)?;
        let before = what_is_at(path);
        fs::remove_file(path)?;
        state.record(path, before);
        Ok(())
    }

    fn remove_folder(&self, path: &Path) -> io::Result<()> {
        let _state = self.next().map_err(|(_, error)| error)?;
        fs::remove_dir_all(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        let mut state = self.next().map_err(|(_, error)| error)?;
        state.unsynced.retain(|change| change.folder != path);
        Ok(())
    }
}
