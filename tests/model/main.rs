//! The gear model, its libraries and their evaluation, and the commands: nothing here starts a service.
#![cfg(test)]

mod architecture;
mod command_line;
mod documents;
mod evaluation;
mod figures;
mod hostile_bytes;
mod import_cycles;
mod incomplete_runs;
mod libraries;
mod outputs;
mod progress;
mod wrong_input;

#[allow(dead_code, reason = "each of the test programs uses a part")]
#[path = "../support/command.rs"]
mod command;
