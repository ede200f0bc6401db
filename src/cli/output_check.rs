//! Checks of an output before the work whose result it gets.
//!
//! No command writes over a file that it reads, or two outputs to one file. What can be computed again
//! replaces an earlier one of the same kind and no other file; recordings replace a file only with `--force`.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use super::CliError;

/// Kinds of outputs that can be computed again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OutputKind {
    /// An HTML page.
    Page,
    /// JSON.
    Json,
    /// A trend as CSV.
    CsvTrend,
    /// A Parquet table.
    Parquet,
    /// A library of wear states.
    Library,
}

impl OutputKind {
    fn name(self) -> &'static str {
        match self {
            Self::Page => "an HTML page",
            Self::Json => "a JSON file",
            Self::CsvTrend => "a CSV table of a trend",
            Self::Parquet => "a Parquet table",
            Self::Library => "a library",
        }
    }

    /// Returns whether a file that begins with `text` is of this kind.
    fn begins_with(self, text: &[u8]) -> bool {
        let text = text.trim_ascii_start().to_ascii_lowercase();
        let marks: &[&str] = match self {
            Self::Page => &["<!doctype html", "<html"],
            Self::Json => &["{", "["],
            Self::CsvTrend => &["start_time"],
            Self::Parquet => &["par1"],
            Self::Library => &["flankwatch-library "],
        };
        marks.iter().any(|mark| text.starts_with(mark.as_bytes()))
    }
}

/// Checks that a command may write a result: an existing file must be of the same kind, or empty. Devices
/// may be written.
pub(super) fn check_result(path: &Path, kind: OutputKind) -> Result<(), CliError> {
    if path.is_file() {
        let mut beginning = Vec::new();
        let read = File::open(path).and_then(|file| file.take(64).read_to_end(&mut beginning));
        read.map_err(CliError::file(path))?;
        if !beginning.is_empty() && !kind.begins_with(&beginning) {
            let detail = format!("{path:?} exists, expected a new file, or {} to replace", kind.name());
            return Err(CliError::Argument(detail));
        }
    }
    check_place(path)
}

/// Checks that a command may write a recording: it replaces an existing file only if it is forced to.
pub(super) fn check_new(path: &Path, is_forced: bool) -> Result<(), CliError> {
    if path.is_file() && !is_forced {
        let detail = format!("{path:?} exists, expected a new file (or --force to replace it)");
        return Err(CliError::Argument(detail));
    }
    check_place(path)
}

/// Checks that the folder of a file exists, and that the file is not a folder itself.
pub(super) fn check_place(path: &Path) -> Result<(), CliError> {
    if path.is_dir() {
        return Err(CliError::file(path)("a folder, expected the name of a file"));
    }
    match path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
        Some(folder) => Err(CliError::file(path)(format!("there is no folder {}", folder.display()))),
        None => Ok(()),
    }
}

/// Checks that the output of an option or argument is none of these other files of the command.
pub(super) fn check_apart<'a>(
    option: &str,
    path: &Path,
    others: impl IntoIterator<Item = &'a Path>,
    what: &str,
) -> Result<(), CliError> {
    let own = location(path);
    // Any number of outputs may go to /dev/null.
    let is_device = path.exists() && !path.is_file();
    if !is_device && others.into_iter().any(|other| location(other) == own) {
        return Err(CliError::argument(option, path.display(), format!("another file than {what}")));
    }
    Ok(())
}

/// The absolute path of a file without links, also of one that does not exist yet.
fn location(path: &Path) -> PathBuf {
    let of_parent = || {
        let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
        let folder = fs::canonicalize(parent.unwrap_or(Path::new("."))).ok()?;
        Some(folder.join(path.file_name()?))
    };
    fs::canonicalize(path).ok().or_else(of_parent).unwrap_or_else(|| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_existing_file_and_a_missing_folder_are_found_before_the_work() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.wav");
        check_new(&path, false).unwrap();
        fs::write(&path, "").unwrap();
        assert!(check_new(&path, false).unwrap_err().to_string().contains("--force"));
        check_new(&path, true).unwrap();
        for (path, expected) in [("none/a.wav", "there is no folder"), ("", "expected the name of a file")] {
            let path = folder.path().join(path);
            for checked in [check_new(&path, true), check_result(&path, OutputKind::Page)] {
                let error = checked.unwrap_err().to_string();
                assert!(error.contains(expected), "{error}");
            }
        }
    }

    #[test]
    fn a_result_replaces_only_its_own_kind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out");
        let kinds = [
            (OutputKind::Page, &b"<!DOCTYPE html><html>"[..]),
            (OutputKind::Json, b"\n{\"a\": 1}"),
            (OutputKind::CsvTrend, b"start_time,rms\n"),
            (OutputKind::Parquet, b"PAR1\0\xff"),
            (OutputKind::Library, b"flankwatch-library 1 damaged"),
        ];
        for (kind, _) in kinds {
            for (other, text) in kinds {
                fs::write(&path, text).unwrap();
                assert_eq!(check_result(&path, kind).is_ok(), kind == other, "{kind:?} over {other:?}");
            }
            for text in [&b"RIFF\0\0\0\0WAVE"[..], b"time,a\n0,1\n", b"name = \"pair\"\n"] {
                fs::write(&path, text).unwrap();
                let error = check_result(&path, kind).unwrap_err().to_string();
                assert!(error.contains("expected a new file, or a"), "{error}");
            }
            fs::write(&path, "").unwrap();
            check_result(&path, kind).unwrap();
            check_result(&folder.path().join("new"), kind).unwrap();
            check_result(Path::new("/dev/null"), kind).unwrap();
        }
    }

    #[cfg(unix)]
    #[test]
    fn one_file_under_two_names_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("sub")).unwrap();
        fs::write(at("in"), "").unwrap();
        std::os::unix::fs::symlink(at("in"), at("link")).unwrap();
        let check = |a: &Path, b: &Path| check_apart("--out", a, [b], "the recordings");
        for (a, b) in [("in", "in"), ("link", "in"), ("sub/../in", "link"), ("new", "sub/../new")] {
            let error = check(&at(a), &at(b)).unwrap_err().to_string();
            assert!(error.contains("expected another file than the recordings"), "{error}");
        }
        check(&at("in"), &at("new")).unwrap();
        check(Path::new("/dev/null"), Path::new("/dev/null")).unwrap();
    }
}
