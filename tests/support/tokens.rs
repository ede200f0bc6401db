//! Tokens made and revoked beside a running service, as `flankwatch token` does it.

use std::path::Path;
use std::sync::Arc;

use flankwatch::http::TokenError;
use flankwatch::store::{Scope, Token};
use jiff::Timestamp;
use tokio::runtime::{Builder, Runtime};

pub(crate) struct Tokens {
    tokens: flankwatch::http::Tokens,
    runtime: Runtime,
}

impl Tokens {
    pub(crate) fn of(data_dir: &Path) -> Self {
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        Self { tokens: flankwatch::http::Tokens::of(data_dir), runtime }
    }

    pub(crate) fn create(&self, name: &str, scope: Scope) -> String {
        self.runtime.block_on(self.tokens.create(name, scope, Timestamp::UNIX_EPOCH)).unwrap()
    }

    pub(crate) fn list(&self) -> Option<Arc<Vec<Token>>> {
        self.runtime.block_on(self.tokens.list()).unwrap()
    }

    pub(crate) fn revoke(&self, id: &str) -> Result<(), TokenError> {
        self.runtime.block_on(self.tokens.revoke(id, Timestamp::UNIX_EPOCH))
    }
}
