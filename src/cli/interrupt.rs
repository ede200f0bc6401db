//! Ctrl-C during long work: the first one stops the work cleanly, the second one ends the process.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Once, PoisonError};
use std::time::Duration;
use std::{fs, io};

use tokio::time::timeout;

/// Exit code of a process that Ctrl-C ended.
const INTERRUPTED: i32 = 130;

/// Returns a flag that the first Ctrl-C sets. Where Ctrl-C cannot be caught, it ends the process as usual.
pub(super) fn interrupted() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    let pressed = Arc::clone(&flag);
    listen(move || {
        if pressed.swap(true, Ordering::Relaxed) {
            std::process::exit(INTERRUPTED);
        }
    });
    flag
}

/// The file that is removed when Ctrl-C ends the process.
static TEMPORARY: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Ends the process at Ctrl-C, from the first call on, without the temporary file named last.
pub(super) fn remove_if_interrupted(temporary: &Path) {
    static LISTENING: Once = Once::new();
    let place = || TEMPORARY.lock().unwrap_or_else(PoisonError::into_inner);
    *place() = Some(temporary.to_owned());
    LISTENING.call_once(|| {
        listen(move || {
            let _ = place().take().map(fs::remove_file);
            std::process::exit(INTERRUPTED);
        });
    });
}

/// Calls a function at each Ctrl-C.
fn listen(on_press: impl FnMut() + Send + 'static) {
    if let Err(error) = try_to_listen(on_press) {
        tracing::warn!(%error, "failed to catch Ctrl-C");
    }
}

fn try_to_listen(mut on_press: impl FnMut() + Send + 'static) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut pressed = Box::pin(tokio::signal::ctrl_c());
    // Polling once installs the handler: from here on Ctrl-C no longer ends the process.
    let _ = runtime.block_on(async { timeout(Duration::ZERO, pressed.as_mut()).await });
    let wait = move || {
        runtime.block_on(async {
            while pressed.as_mut().await.is_ok() {
                on_press();
                pressed.set(tokio::signal::ctrl_c());
            }
        });
    };
    std::thread::Builder::new().name("interrupt".into()).spawn(wait).map(|_| ())
}
