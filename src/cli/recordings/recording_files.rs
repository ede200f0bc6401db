//! Recordings given on the command line: files, folders of files, and patterns such as `day-*.wav`.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::cli::CliError;
use crate::cli::simulation::simulate::TRUTH_FILE_NAME;
use crate::recording::{EXTENSIONS, RecordingFile};

/// Expands folders to the recordings in them and in their subfolders, and patterns that the shell did not
/// expand to the files that match; both in order of their paths. A file that is given repeatedly counts once.
pub(in crate::cli) fn recording_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, CliError> {
    let mut files = Vec::new();
    for path in paths {
        if !path.exists() && is_pattern(path) {
            files.extend(matching(path)?);
            continue;
        }
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let mut found = recordings_in(path)?;
        if found.is_empty() {
            let extensions = EXTENSIONS.join(", ");
            return Err(CliError::Argument(format!(
                "no recording in {}, expected files with the extension {extensions}",
                path.display()
            )));
        }
        found.sort();
        files.extend(found);
    }
    let mut known = HashSet::new();
    files.retain(|path| known.insert(fs::canonicalize(path).unwrap_or_else(|_| path.clone())));
    Ok(files)
}

fn is_pattern(path: &Path) -> bool {
    path.to_string_lossy().contains(['*', '?', '['])
}

fn matching(pattern: &Path) -> Result<Vec<PathBuf>, CliError> {
    let name = pattern.to_string_lossy();
    let invalid = |reason: String| CliError::Argument(format!("{name}: {reason}"));
    let paths = glob::glob(&name).map_err(|error| invalid(error.to_string()))?;
    let found: Result<Vec<PathBuf>, _> =
        paths.filter(|path| !matches!(path, Ok(path) if path.is_dir())).collect();
    let found = found.map_err(|error| invalid(error.to_string()))?;
    if found.is_empty() {
        return Err(invalid("no file matches this pattern".to_owned()));
    }
    Ok(found)
}

/// The recordings in a folder and its subfolders; links to folders are not followed. The `truth.csv` of a run
/// that `flankwatch simulate` wrote is a table of depths, not a recording.
fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, CliError> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(CliError::file(&folder))? {
            let entry = entry.map_err(CliError::file(&folder))?;
            let path = entry.path();
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                folders.push(path);
            } else if path.is_file()
                && RecordingFile::has_extension(&path)
                && entry.file_name() != TRUTH_FILE_NAME
            {
                found.push(path);
            }
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_patterns_expand_to_recordings() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["b.CSV", "a.csv.gz", "c.wav", "notes.txt", "truth.csv"] {
            fs::write(path(name), "").unwrap();
        }
        fs::create_dir(path("empty")).unwrap();
        fs::create_dir(path("second")).unwrap();
        fs::write(path("second/a.npy"), "").unwrap();
        let found = recording_files(&[path("x.bin"), folder.path().to_owned()]).unwrap();
        assert_eq!(
            found,
            [path("x.bin"), path("a.csv.gz"), path("b.CSV"), path("c.wav"), path("second/a.npy")]
        );
        assert_eq!(
            recording_files(&[path("a.csv.gz"), path("second/../a.csv.gz")]).unwrap(),
            [path("a.csv.gz")]
        );
        assert_eq!(recording_files(&[path("[ab].[cC]*")]).unwrap(), [path("a.csv.gz"), path("b.CSV")]);
        for (pattern, expected) in [("*.flac", "no file matches"), ("[", "pattern")] {
            let error = recording_files(&[path(pattern)]).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains(pattern), "{error}");
        }
        let error = recording_files(&[path("empty")]).unwrap_err().to_string();
        assert!(error.contains("no recording in") && error.contains(".csv.gz"), "{error}");
    }
}
