//! Finished parts of a library that is being built, kept so that a stopped build can go on.
//!
//! A line that names the library, then one line a part with its hash. Parts are only ever added, so that a
//! build that is cut off leaves at most one broken line; broken lines are left out.

use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::LibraryError;
use super::file::{FORMAT_VERSION, hex};
use super::part::{Part, PartStore};

const MAGIC: &str = "flankwatch-library-parts";

/// Where the parts of a library that will be kept in `path` are kept while it is built: beside it, with
/// `.parts` added to its name.
pub fn checkpoint_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".parts");
    PathBuf::from(name)
}

/// The file.
#[derive(Debug)]
pub(super) struct Checkpoint {
    path: PathBuf,
    /// Open for further parts once [`PartStore::open`] was called.
    file: Mutex<Option<File>>,
}

impl Checkpoint {
    /// The checkpoint of a library that will be kept in `library`.
    pub(super) fn for_library(library: &Path) -> Self {
        Self::at(checkpoint_path(library))
    }

    fn at(path: PathBuf) -> Self {
        Self { path, file: Mutex::default() }
    }

    /// Removes it: the library is kept whole.
    pub(super) fn remove(&self) -> Result<(), LibraryError> {
        match fs::remove_file(&self.path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => Err(self.failed(source)),
            _ => Ok(()),
        }
    }

    fn failed(&self, source: io::Error) -> LibraryError {
        LibraryError::Io { path: self.path.clone(), source }
    }
}

impl PartStore for Checkpoint {
    /// Starts a new file where there is none or another library's.
    fn open(&self, id: &str) -> Result<Vec<Part>, LibraryError> {
        let path = &self.path;
        let failed = |source| self.failed(source);
        let header = format!("{MAGIC} {FORMAT_VERSION} {id}");
        let parts = match fs::read(path) {
            Ok(bytes) => read(&bytes, &header, path),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(source) => return Err(failed(source)),
        };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder).map_err(failed)?;
        }
        if parts.is_none() {
            fs::write(path, format!("{header}\n")).map_err(failed)?;
        }
        let file = OpenOptions::new().append(true).open(path).map_err(failed)?;
        *self.file.lock().unwrap_or_else(PoisonError::into_inner) = Some(file);
        Ok(parts.unwrap_or_default())
    }

    fn add(&self, part: &Part) -> Result<(), LibraryError> {
        let body = serde_json::to_vec(part).expect("numbers, strings and lists always serialise");
        // It starts a line of its own, whatever an earlier build that was cut off has left.
        let mut line = format!("\n{} ", hex(&body)).into_bytes();
        line.extend_from_slice(&body);
        line.push(b'\n');
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let closed = || io::Error::other("the checkpoint is not open");
        let file = file.as_mut().ok_or_else(|| self.failed(closed()))?;
        file.write_all(&line).map_err(|source| self.failed(source))
    }
}

/// The whole parts, or nothing where the first line is not `header`.
fn read(bytes: &[u8], header: &str, path: &Path) -> Option<Vec<Part>> {
    let mut lines = bytes.split(|byte| *byte == b'\n');
    if lines.next() != Some(header.as_bytes()) {
        tracing::warn!(file = %path.display(), "the kept parts are damaged or another library's; beginning again");
        return None;
    }
    let part = |line: &[u8]| -> Option<Part> {
        let (hash, body) = line.split_at_checked(64)?;
        let body = body.strip_prefix(b" ")?;
        (hash == hex(body).as_bytes()).then(|| serde_json::from_slice(body).ok())?
    };
    let mut parts = Vec::new();
    for line in lines.filter(|line| !line.is_empty()) {
        match part(line) {
            Some(part) => parts.push(part),
            None => tracing::warn!(file = %path.display(), "a kept part is damaged; simulating it again"),
        }
    }
    Some(parts)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Write;
    use std::path::Path;

    use super::{Checkpoint, Part, PartStore, checkpoint_path};

    fn open(path: &Path, id: &str) -> (Checkpoint, Vec<Part>) {
        let checkpoint = Checkpoint::at(path.to_owned());
        let parts = checkpoint.open(id).unwrap();
        (checkpoint, parts)
    }

    fn part(first: usize) -> Part {
        Part { first, torque: 1, states: Vec::new(), features: vec![Vec::new(); 3] }
    }

    #[test]
    fn whole_parts_are_taken_up_and_broken_ones_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = checkpoint_path(&folder.path().join("new/library.fwlib"));
        assert!(path.ends_with("new/library.fwlib.parts"));
        let (checkpoint, parts) = open(&path, "a");
        assert_eq!(parts, []);
        checkpoint.add(&part(0)).unwrap();
        checkpoint.add(&part(8)).unwrap();
        drop(checkpoint);
        // Cut off in the middle of a line, then gone on with.
        let whole = fs::read(&path).unwrap();
        fs::write(&path, &whole[..whole.len() - 20]).unwrap();
        let (checkpoint, parts) = open(&path, "a");
        assert_eq!(parts, [part(0)]);
        checkpoint.add(&part(16)).unwrap();
        let (_, parts) = open(&path, "a");
        assert_eq!(parts, [part(0), part(16)]);
        // A changed byte.
        let mut bytes = fs::read(&path).unwrap();
        let place = bytes.iter().position(|byte| *byte == b'{').unwrap();
        bytes[place + 3] ^= 1;
        fs::write(&path, bytes).unwrap();
        assert_eq!(open(&path, "a").1, [part(16)]);
        checkpoint.remove().unwrap();
        checkpoint.remove().unwrap();
        assert!(!path.exists());
    }

    #[test]
    fn another_librarys_parts_are_not_taken() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.parts");
        open(&path, "a").0.add(&part(0)).unwrap();
        assert_eq!(open(&path, "b").1, []);
        assert_eq!(open(&path, "a").1, []);
        let mut file = fs::File::create(&path).unwrap();
        file.write_all(&[0xff; 100]).unwrap();
        let (checkpoint, parts) = open(&path, "a");
        assert_eq!(parts, []);
        checkpoint.add(&part(3)).unwrap();
        assert_eq!(open(&path, "a").1, [part(3)]);
    }
}
