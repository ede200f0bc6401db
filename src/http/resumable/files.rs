//! Files of the uploads of one machine: what has come of each, and a description beside it.
//!
//! How far an upload is, is the length of its file: a description may be older than that, and one that could not be written anew costs nothing that
//! has come.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::{ResumableUpload, UploadState};
use crate::service::ServiceError;

/// What has come.
const PART: &str = "part";
/// The description.
const DESCRIPTION: &str = "json";
/// The description to come.
const NEXT: &str = "new";

/// A folder of uploads.
#[derive(Debug, Clone)]
pub(super) struct UploadFiles {
    folder: PathBuf,
}

impl UploadFiles {
    /// Makes the folder where it is missing.
    pub(super) fn open(folder: PathBuf) -> io::Result<Self> {
        fs::create_dir_all(&folder)?;
        Ok(Self { folder })
    }

    fn path(&self, id: &str, extension: &str) -> PathBuf {
        self.folder.join(id).with_extension(extension)
    }

    /// Where an upload's bytes are.
    pub(super) fn part(&self, id: &str) -> PathBuf {
        self.path(id, PART)
    }

    /// The uploads that are described, those under way as far as their files are. Removes what belongs to none of them: a process that was killed, or
    /// a disk that was full, leaves a part or a description without the other.
    pub(super) fn take_up(&self) -> io::Result<Vec<ResumableUpload>> {
        let mut uploads = Vec::new();
        let mut files = Vec::new();
        let mut needed = BTreeSet::new();
        for entry in fs::read_dir(&self.folder)? {
            let path = entry?.path();
            match path.extension().and_then(|extension| extension.to_str()) {
                Some(PART | NEXT) => files.push(path),
                Some(DESCRIPTION) => match described(&path) {
                    Ok(Some(upload)) => {
                        if upload.state.is_open() {
                            needed.insert(self.part(&upload.id));
                        }
                        uploads.push(upload);
                    }
                    Ok(None) => files.push(path),
                    Err(error) => {
                        tracing::warn!(file = %path.display(), %error, "description of an upload cannot be read");
                        needed.insert(path.with_extension(PART));
                    }
                },
                _ => {}
            }
        }
        let mut removed = 0;
        for path in files.iter().filter(|path| !needed.contains(*path)) {
            match fs::remove_file(path) {
                Ok(()) => removed += 1,
                Err(error) => tracing::warn!(file = %path.display(), %error, "file of no upload not removed"),
            }
        }
        if removed > 0 {
            tracing::info!(files = removed, "removed files of resumable uploads that no description belongs to");
        }
        for upload in uploads.iter_mut().filter(|upload| upload.state.is_open()) {
            // One that was being read is so no longer, and is as whole as its file.
            upload.state = UploadState::Receiving;
            upload.offset = fs::metadata(self.part(&upload.id)).map_or(0, |file| file.len().min(upload.length));
        }
        Ok(uploads)
    }

    /// Begins an upload; when this returns it is on the disk.
    pub(super) fn begin(&self, upload: &ResumableUpload) -> Result<(), ServiceError> {
        let path = self.part(&upload.id);
        File::create(&path).map_err(|source| failed(&path, source))?;
        self.keep(upload)
    }

    /// Keeps the description of an upload; when this returns it is on the disk, and so is its name.
    pub(super) fn keep(&self, upload: &ResumableUpload) -> Result<(), ServiceError> {
        let path = self.path(&upload.id, DESCRIPTION);
        let next = self.path(&upload.id, NEXT);
        let write = || {
            let mut file = File::create(&next)?;
            file.write_all(&serde_json::to_vec(upload)?)?;
            file.sync_all()?;
            fs::rename(&next, &path)?;
            File::open(&self.folder)?.sync_all()
        };
        write().map_err(|source| {
            // A full disk must not also keep the part that fitted.
            let _ = fs::remove_file(&next);
            failed(&path, source)
        })
    }

    /// The file of an upload, to be written to behind the first `at` bytes.
    pub(super) fn append(&self, id: &str, at: u64) -> Result<File, ServiceError> {
        let path = self.part(id);
        let open = || {
            let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(&path)?;
            file.seek(SeekFrom::Start(at))?;
            Ok(file)
        };
        open().map_err(|source| failed(&path, source))
    }

    /// Puts what has come on the disk: the file is `end` bytes long when this returns, or as long as it was, `at`, where that failed.
    pub(super) fn sync(&self, id: &str, file: &File, at: u64, end: u64) -> Result<(), ServiceError> {
        // Of bytes that could not be written as a whole the first ones may be there.
        let synced = file.set_len(end).and_then(|()| file.sync_data());
        synced.map_err(|source| {
            // What of them is on the disk is not known.
            if let Err(error) = file.set_len(at) {
                tracing::warn!(upload = id, %error, "bytes that may not be on the disk not taken back");
            }
            failed(&self.part(id), source)
        })
    }

    /// Keeps what became of an upload; its bytes go.
    pub(super) fn end(&self, upload: &ResumableUpload) -> Result<(), ServiceError> {
        let kept = self.keep(upload);
        let _ = fs::remove_file(self.part(&upload.id));
        // Where there was no room for the description there is now.
        kept.or_else(|_| self.keep(upload))
    }

    /// Removes what there is of an upload. The description goes first: bytes without one are removed at the next start.
    pub(super) fn remove(&self, id: &str) {
        for extension in [DESCRIPTION, NEXT, PART] {
            // The part of an upload that was read is gone already.
            let _ = fs::remove_file(self.path(id, extension));
        }
    }
}

/// What a description says; nothing where it was cut short as the machine stopped.
///
/// Errors: the disk does not give it, or it is that of a later version, which may still go on with it.
fn described(path: &Path) -> io::Result<Option<ResumableUpload>> {
    match serde_json::from_slice(&fs::read(path)?) {
        Ok(upload) => Ok(Some(upload)),
        Err(error) if error.is_data() => Err(error.into()),
        Err(_) => Ok(None),
    }
}

fn failed(path: &Path, source: io::Error) -> ServiceError {
    ServiceError::File {
        action: "write",
        path: path.to_path_buf(),
        source,
    }
}
