//! Writing results so that a reader never finds half a file.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use super::CliError;

/// Prints to standard output; a reader that has gone away is no error.
pub(super) fn print(text: &str) -> Result<(), CliError> {
    match io::stdout().lock().write_all(text.as_bytes()) {
        Err(source) if source.kind() != io::ErrorKind::BrokenPipe => {
            Err(CliError::Io { path: "standard output".into(), source })
        }
        _ => Ok(()),
    }
}

/// Writes a whole file under a temporary name, then renames it.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let temporary = path.with_extension("part");
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(CliError::io(path))
}
