//! Reading an upload that is whole.

use std::path::Path;
use std::time::Duration;

use super::{ResumableUpload, ResumableUploads, shared};
use crate::http::app::App;
use crate::http::body::SpooledBody;
use crate::http::problem::Problem;
use crate::http::uploads::{self, UploadAnswer};

/// Wait before an upload is read again that could not be read now.
const READ_AGAIN: Duration = Duration::from_secs(1);

/// Where the disk is full, each wait is twice the one before, up to this: the recording is read from its beginning each time.
const LONGEST_WAIT: Duration = Duration::from_secs(60);

/// Reads an upload that is whole, waiting for its turn; what may pass is waited for, as long as the upload is kept. `path` is where it is, or where
/// it is put together. None where it was given up while it waited, or where the store is closed: then it is read by whoever opens the store next.
pub(super) async fn read(app: &App, upload: &ResumableUpload, path: &Path) -> Option<Result<UploadAnswer, Problem>> {
    let mut wait = READ_AGAIN;
    while app.resumable.note_wait(&upload.id, None).await {
        let taken = match app.service.workers.admit() {
            Err(busy) => Err(busy.into()),
            Ok(ticket) => match spool(app, upload, path).await {
                Ok(spooled) => uploads::take_recording(app, &upload.asset, spooled, ticket).await,
                Err(problem) => Err(problem),
            },
        };
        if app.service.store.is_closed() {
            return None;
        }
        match taken {
            Err(problem) if problem.may_pass() && app.service.now() < upload.expires_at => {
                tracing::debug!(upload = upload.id, problem = problem.detail(), "read again later");
                app.resumable.note_wait(&upload.id, Some(problem.detail())).await;
                wait = if problem.is_no_room() { wait } else { READ_AGAIN };
                tokio::time::sleep(wait).await;
                wait = (2 * wait).min(LONGEST_WAIT);
            }
            taken => return Some(taken),
        }
    }
    None
}

/// An upload as one file.
async fn spool(app: &App, upload: &ResumableUpload, path: &Path) -> Result<SpooledBody, Problem> {
    match &*app.resumable {
        // It is read again where it could not be read now.
        ResumableUploads::Folder(_) => Ok(SpooledBody::kept_at(path.to_path_buf())),
        ResumableUploads::Shared(_) => shared::compose(app, upload, path).await,
    }
}
