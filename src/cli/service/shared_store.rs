//! Cluster settings from the settings file and the environment.

use super::serve_error::ServeError;
use crate::cluster::{ClusterSecrets, ClusterSettings, ClusterTable};

/// Resolves the table `cluster` with the secrets of the environment.
pub(super) fn resolve(table: ClusterTable) -> Result<ClusterSettings, ServeError> {
    let env = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let secrets = ClusterSecrets {
        database_url: env("FLANKWATCH_DATABASE_URL"),
        nats_password: env("FLANKWATCH_NATS_PASSWORD"),
        nats_token: env("FLANKWATCH_NATS_TOKEN"),
        s3_access_key_id: env("FLANKWATCH_S3_ACCESS_KEY_ID"),
        s3_secret_access_key: env("FLANKWATCH_S3_SECRET_ACCESS_KEY"),
    };
    Ok(table.resolve(secrets)?)
}
