//! Ctrl-C during long work: the first one stops the work cleanly, the second one ends the process.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::time::timeout;

/// Exit code of a process that Ctrl-C ended.
const INTERRUPTED: i32 = 130;

/// Returns a flag that the first Ctrl-C sets. Where Ctrl-C cannot be caught, it ends the process as usual.
pub(super) fn interrupted() -> Arc<AtomicBool> {
    let flag = Arc::new(AtomicBool::new(false));
    if let Err(error) = listen(Arc::clone(&flag)) {
        tracing::warn!(%error, "failed to catch Ctrl-C");
    }
    flag
}

fn listen(flag: Arc<AtomicBool>) -> io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let mut pressed = Box::pin(tokio::signal::ctrl_c());
    // Polling once installs the handler: from here on Ctrl-C no longer ends the process.
    let _ = runtime.block_on(async { timeout(Duration::ZERO, pressed.as_mut()).await });
    let wait = move || {
        runtime.block_on(async {
            while pressed.as_mut().await.is_ok() {
                if flag.swap(true, Ordering::Relaxed) {
                    std::process::exit(INTERRUPTED);
                }
                pressed.set(tokio::signal::ctrl_c());
            }
        });
    };
    std::thread::Builder::new().name("interrupt".into()).spawn(wait).map(|_| ())
}
