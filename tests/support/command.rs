//! The commands as a user runs them.

use std::process::{Command, Output};

/// What a command said and how it ended.
pub(crate) struct Said(Output);

impl Said {
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

    /// Checks that the command refused, did not panic, and named every one of the words.
    #[track_caller]
    pub(crate) fn expect_refusal(self, words: &[&str]) -> Self {
        let said = self.err();
        assert!(matches!(self.0.status.code(), Some(1 | 2)), "{:?}: {said}", self.0.status);
        for word in words {
            assert!(said.contains(word), "{word:?} in {said:?}");
        }
        self
    }
}

/// Runs the program and waits for it.
pub(crate) fn flankwatch(words: &[&str]) -> Said {
    Said(Command::new(env!("CARGO_BIN_EXE_flankwatch")).args(words).output().unwrap())
}
