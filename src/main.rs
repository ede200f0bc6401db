//! The `flankwatch` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    flankwatch::cli::run()
}
