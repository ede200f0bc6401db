//! Output to standard output and to files; files are replaced atomically.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::CliError;

/// Prints to standard output; a closed pipe is not an error.
pub(super) fn print(text: &str) -> Result<(), CliError> {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Err(source) if source.kind() != io::ErrorKind::BrokenPipe => {
            Err(CliError::file("standard output")(source))
        }
        _ => Ok(()),
    }
}

/// Prints a line to standard error; a closed pipe is not an error.
pub(super) fn note(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// A number of things, for example `1 record` or `2 records`.
pub(super) fn counted(count: u64, thing: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {thing}{ending}")
}

/// Writes a file under a temporary name, then renames it.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let partial = PartialFile::create(path)?;
    (&partial.file).write_all(bytes).map_err(CliError::file(path))?;
    partial.complete()
}

/// A file under a temporary name in the same folder; removed on drop unless it is completed.
pub(super) struct PartialFile<'a> {
    pub(super) file: File,
    temporary: PathBuf,
    path: &'a Path,
}

impl<'a> PartialFile<'a> {
    pub(super) fn create(path: &'a Path) -> Result<Self, CliError> {
        let name = path.file_name().unwrap_or_default().display();
        let temporary = path.with_file_name(format!(".{name}.{}.partial", std::process::id()));
        let file = File::create(&temporary).map_err(CliError::file(path))?;
        Ok(Self { file, temporary, path })
    }

    /// Syncs the file and renames it.
    pub(super) fn complete(self) -> Result<(), CliError> {
        let renamed = self.file.sync_all().and_then(|()| fs::rename(&self.temporary, self.path));
        renamed.map_err(CliError::file(self.path))
    }
}

impl Drop for PartialFile<'_> {
    fn drop(&mut self) {
        // The error that kept the file from its name is the one to report; completed, it has another name.
        let _ = fs::remove_file(&self.temporary);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_appears_when_it_is_complete_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.csv");
        let names = || -> Vec<_> {
            fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect()
        };
        write_file(&path, b"earlier").unwrap();
        let partial = PartialFile::create(&path).unwrap();
        (&partial.file).write_all(b"half").unwrap();
        assert_eq!(names().len(), 2);
        drop(partial);
        assert_eq!((fs::read(&path).unwrap(), names()), (b"earlier".to_vec(), vec!["out.csv".into()]));
        write_file(&path, b"later").unwrap();
        assert_eq!((fs::read(&path).unwrap(), names()), (b"later".to_vec(), vec!["out.csv".into()]));
    }
}
