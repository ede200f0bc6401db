//! The folders on disk, and the recordings that may be replayed: only files inside the configured folder.

use std::fs;
use std::path::{Component, Path, PathBuf};

use jiff::Timestamp;

use crate::recording::RecordingFile;
use crate::service::error::ServiceError;
use crate::service::limits::ServiceFolders;

/// Creates missing folders and removes the files of interrupted uploads.
pub(crate) fn prepare(folders: &ServiceFolders) -> Result<(), ServiceError> {
    for folder in [&folders.libraries, &folders.recordings, &folders.uploads] {
        fs::create_dir_all(folder).map_err(|source| ServiceError::File {
            action: "create the folder",
            path: folder.clone(),
            source,
        })?;
    }
    let stale = fs::read_dir(&folders.uploads).map_err(|source| ServiceError::File {
        action: "list the folder",
        path: folders.uploads.clone(),
        source,
    })?;
    for entry in stale.flatten() {
        if let Err(error) = fs::remove_file(entry.path()) {
            tracing::warn!(file = %entry.path().display(), %error, "failed to remove an unfinished upload");
        }
    }
    Ok(())
}

/// A recording that may be replayed.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct ReplayFile {
    /// Its path inside the folder.
    pub file: String,
    /// Its length in bytes.
    pub bytes: u64,
    /// When it was last modified.
    pub modified_at: Timestamp,
}

/// Maximum number of files that are listed.
const MAX_FILES: usize = 1000;

/// Maximum depth of subfolders that are searched.
const MAX_DEPTH: usize = 4;

/// The recordings in the folder, the latest first; symbolic links are skipped.
pub(crate) fn recordings(folder: &Path) -> Vec<ReplayFile> {
    let mut found = Vec::new();
    let mut left = vec![(folder.to_owned(), 0)];
    while let Some((inner, depth)) = left.pop() {
        for entry in fs::read_dir(inner).into_iter().flatten().flatten() {
            let path = entry.path();
            let Ok(kind) = entry.file_type() else { continue };
            if kind.is_dir() && depth < MAX_DEPTH {
                left.push((path, depth + 1));
            } else if kind.is_file()
                && RecordingFile::has_extension(&path)
                && let (Ok(metadata), Ok(file)) = (entry.metadata(), path.strip_prefix(folder))
                && let Some(file) = file.to_str()
                && let Ok(modified_at) =
                    metadata.modified().map_err(drop).and_then(|time| Timestamp::try_from(time).map_err(drop))
            {
                found.push(ReplayFile { file: file.to_owned(), bytes: metadata.len(), modified_at });
            }
        }
    }
    found.sort_by(|a, b| b.modified_at.cmp(&a.modified_at).then_with(|| a.file.cmp(&b.file)));
    found.truncate(MAX_FILES);
    found
}

/// Resolves the path of a recording inside the folder.
///
/// # Errors
/// An absolute path, `..`, a symbolic link out of the folder, or anything but a file.
pub(crate) fn find(folder: &Path, file: &str) -> Result<PathBuf, ServiceError> {
    let refuse = |reason| ServiceError::ReplayFile { file: file.to_string(), reason };
    let relative = Path::new(file);
    let is_plain = relative.components().all(|part| matches!(part, Component::Normal(_)));
    if file.is_empty() || file.contains(['\0', '\\']) || !is_plain {
        return Err(refuse(
            "is not a path inside the replay folder, expected a relative path without \"..\"",
        ));
    }
    let folder =
        fs::canonicalize(folder).map_err(|_| refuse("is not available: the replay folder cannot be read"))?;
    let path = fs::canonicalize(folder.join(relative)).map_err(|_| refuse("is not in the replay folder"))?;
    if !path.starts_with(&folder) {
        return Err(refuse("is a link out of the replay folder"));
    }
    if !path.is_file() {
        return Err(refuse("is not a file"));
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn recordings_inside_the_folder_are_listed() {
        let outside = tempfile::tempdir().unwrap();
        let folder = outside.path().join("recordings");
        fs::create_dir_all(folder.join("line 1")).unwrap();
        fs::write(folder.join("line 1/run.mcap"), b"abc").unwrap();
        fs::write(folder.join("notes.txt"), b"x").unwrap();
        fs::write(folder.join("table.csv.gz"), b"x").unwrap();
        fs::write(outside.path().join("secret.mcap"), b"x").unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(outside.path().join("secret.mcap"), folder.join("out.mcap")).unwrap();
        let found = recordings(&folder);
        let mut files: Vec<_> = found.iter().map(|one| (one.file.as_str(), one.bytes)).collect();
        files.sort_unstable();
        assert_eq!(files, [("line 1/run.mcap", 3), ("table.csv.gz", 1)]);
        assert!(recordings(&outside.path().join("none")).is_empty());
    }

    #[test]
    fn only_files_inside_the_folder_are_found() {
        let outside = tempfile::tempdir().unwrap();
        let folder = outside.path().join("recordings");
        fs::create_dir_all(folder.join("line 1")).unwrap();
        fs::write(folder.join("line 1/run.mcap"), b"x").unwrap();
        fs::write(outside.path().join("secret"), b"x").unwrap();
        assert!(find(&folder, "line 1/run.mcap").is_ok());
        let absolute = outside.path().join("secret");
        for file in [
            "",
            ".",
            "..",
            "../secret",
            "line 1/../../secret",
            "line 1",
            "none.mcap",
            "a\0b",
            "..\\secret",
            absolute.to_str().unwrap(),
        ] {
            assert!(matches!(find(&folder, file), Err(ServiceError::ReplayFile { .. })), "{file:?}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn only_links_within_the_folder_are_followed() {
        let outside = tempfile::tempdir().unwrap();
        let folder = outside.path().join("recordings");
        fs::create_dir_all(&folder).unwrap();
        fs::write(outside.path().join("secret"), b"x").unwrap();
        fs::write(folder.join("run"), b"x").unwrap();
        std::os::unix::fs::symlink(outside.path().join("secret"), folder.join("out")).unwrap();
        std::os::unix::fs::symlink(outside.path(), folder.join("up")).unwrap();
        std::os::unix::fs::symlink(folder.join("run"), folder.join("in")).unwrap();
        assert!(find(&folder, "out").is_err());
        assert!(find(&folder, "up/secret").is_err());
        assert!(find(&folder, "in").is_ok());
    }
}
