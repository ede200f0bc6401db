//! Recordings named on the command line: files, folders with files in them, and patterns such as `day-*.wav`.

use std::fs;
use std::path::{Path, PathBuf};

use super::CliError;

/// How the names of recordings end.
const ENDINGS: [&str; 7] = [".wav", ".flac", ".mcap", ".csv", ".csv.gz", ".mat", ".npy"];

/// The files in their order; a folder stands for the recordings in it, and a pattern that the shell has left as it
/// is for what it matches, in the order of their names.
pub(super) fn recording_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, CliError> {
    let mut files = Vec::new();
    for path in named {
        if !path.exists() && is_pattern(path) {
            files.extend(matching(path)?);
            continue;
        }
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let entries = fs::read_dir(path).map_err(CliError::io(path))?;
        let mut found = Vec::new();
        for entry in entries {
            let file = entry.map_err(CliError::io(path))?.path();
            if file.is_file() && is_recording(&file) {
                found.push(file);
            }
        }
        if found.is_empty() {
            let endings = ENDINGS.join(", ");
            return Err(CliError::Argument(format!(
                "no recording in {}, expected files that end in {endings}",
                path.display()
            )));
        }
        found.sort();
        files.extend(found);
    }
    Ok(files)
}

fn is_pattern(path: &Path) -> bool {
    path.to_string_lossy().contains(['*', '?', '['])
}

fn matching(pattern: &Path) -> Result<Vec<PathBuf>, CliError> {
    let name = pattern.to_string_lossy();
    let wrong = |what: String| CliError::Argument(format!("{name}: {what}"));
    let paths = glob::glob(&name).map_err(|error| wrong(error.to_string()))?;
    let found: Result<Vec<PathBuf>, _> =
        paths.filter(|path| !matches!(path, Ok(path) if path.is_dir())).collect();
    let found = found.map_err(|error| wrong(error.to_string()))?;
    if found.is_empty() {
        return Err(wrong("no file matches this pattern".to_owned()));
    }
    Ok(found)
}

fn is_recording(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    ENDINGS.iter().any(|ending| name.ends_with(ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_stands_for_its_recordings() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for name in ["b.CSV", "a.csv.gz", "c.wav", "notes.txt"] {
            fs::write(path(name), "").unwrap();
        }
        fs::create_dir(path("empty")).unwrap();
        let found = recording_files(&[path("x.bin"), folder.path().to_owned()]).unwrap();
        assert_eq!(found, [path("x.bin"), path("a.csv.gz"), path("b.CSV"), path("c.wav")]);
        assert_eq!(recording_files(&[path("*.[cC]*")]).unwrap(), [path("a.csv.gz"), path("b.CSV")]);
        for (pattern, said) in [("*.flac", "no file matches"), ("[", "pattern")] {
            let error = recording_files(&[path(pattern)]).unwrap_err().to_string();
            assert!(error.contains(said) && error.contains(pattern), "{error}");
        }
        let error = recording_files(&[path("empty")]).unwrap_err().to_string();
        assert!(error.contains("no recording in") && error.contains(".csv.gz"), "{error}");
    }
}
