//! Output to standard output and to files; files are replaced atomically.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::CliError;
use super::interrupt::remove_if_interrupted;

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
pub(super) fn print_stderr(line: &str) {
    let _ = writeln!(io::stderr(), "{}", printable(line));
}

/// Escapes control characters, which a file's name may have and a terminal would obey.
pub(super) fn printable(text: &str) -> String {
    let escape = |letter: char| match letter {
        '\n' | '\t' => letter.to_string(),
        letter if letter.is_control() => letter.escape_default().to_string(),
        letter => letter.to_string(),
    };
    text.chars().map(escape).collect()
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

/// A file under a temporary name in the same folder; removed on drop and on Ctrl-C unless it is completed.
/// Anything that is not a regular file, such as `/dev/null`, is written directly.
pub(super) struct PartialFile {
    pub(super) file: File,
    temporary: Option<PathBuf>,
    path: PathBuf,
}

impl PartialFile {
    pub(super) fn create(path: &Path) -> Result<Self, CliError> {
        // A link is kept: what it leads to is replaced.
        let path = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        if path.exists() && !path.is_file() {
            let file = OpenOptions::new().write(true).open(&path).map_err(CliError::file(&path))?;
            return Ok(Self { file, temporary: None, path });
        }
        let name = path.file_name().unwrap_or_default().display();
        let temporary = path.with_file_name(format!(".{name}.{}.partial", std::process::id()));
        remove_if_interrupted(&temporary);
        let file = File::create(&temporary).map_err(CliError::file(&path))?;
        Ok(Self { file, temporary: Some(temporary), path })
    }

    /// Syncs the file and renames it.
    pub(super) fn complete(self) -> Result<(), CliError> {
        let Some(temporary) = &self.temporary else { return Ok(()) };
        let renamed = self.file.sync_all().and_then(|()| fs::rename(temporary, &self.path));
        renamed.map_err(CliError::file(&self.path))
    }
}

impl Drop for PartialFile {
    fn drop(&mut self) {
        // The error that kept the file from its name is the one to report; completed, it has another name.
        let _ = self.temporary.as_ref().map(fs::remove_file);
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

    #[cfg(unix)]
    #[test]
    fn a_link_and_a_device_stay_what_they_are() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let [target, link] = ["target", "link"].map(|name| folder.path().join(name));
        fs::write(&target, "earlier").unwrap();
        symlink(&target, &link).unwrap();
        write_file(&link, b"new").unwrap();
        assert!(link.is_symlink() && fs::read(&target).unwrap() == b"new");
        assert!(PartialFile::create(Path::new("/dev/null")).unwrap().temporary.is_none());
    }

    #[test]
    fn control_characters_are_escaped() {
        assert_eq!(printable("a\u{1b}[31m.wav: é\n"), "a\\u{1b}[31m.wav: é\n");
    }
}
