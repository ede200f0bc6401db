//! Runs the commands as a user does.

use std::process::{Command, Output};

/// Output and exit status of a command.
pub(crate) struct CommandOutput(Output);

impl CommandOutput {
    pub(crate) fn out(&self) -> String {
        String::from_utf8_lossy(&self.0.stdout).into_owned()
    }

    pub(crate) fn err(&self) -> String {
        String::from_utf8_lossy(&self.0.stderr).into_owned()
    }

    #[track_caller]
    pub(crate) fn expect_success(self) -> Self {
        assert!(self.0.status.success(), "{}", self.err());
        self
    }

    /// Checks that the command failed without a panic and that its error contains every one of the words.
    #[track_caller]
    pub(crate) fn expect_failure(self, words: &[&str]) -> Self {
        let stderr = self.err();
        assert!(matches!(self.0.status.code(), Some(1 | 2)), "{:?}: {stderr}", self.0.status);
        for word in words {
            assert!(stderr.contains(word), "{word:?} in {stderr:?}");
        }
        self
    }
}

/// Runs the program and waits for its end.
pub(crate) fn flankwatch(words: &[&str]) -> CommandOutput {
    CommandOutput(Command::new(env!("CARGO_BIN_EXE_flankwatch")).args(words).output().unwrap())
}
