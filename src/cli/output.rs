//! Output to standard output and to files; files are replaced atomically.

use std::fs;
use std::io::{self, Write};
use std::path::Path;

use super::CliError;

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
pub(super) fn note(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// A number of things, for example `1 record` or `2 records`.
pub(super) fn counted(count: u64, thing: &str) -> String {
    let ending = if count == 1 { "" } else { "s" };
    format!("{count} {thing}{ending}")
}

/// Writes a file under a temporary name, then renames it.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), CliError> {
    let temporary = path.with_extension("part");
    fs::write(&temporary, bytes).and_then(|()| fs::rename(&temporary, path)).map_err(CliError::file(path))
}
