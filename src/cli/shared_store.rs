//! The settings of a cluster.

use super::serve::ServeError;
use crate::cluster::{ClusterSecrets, ClusterSettings, ClusterTable};

/// The settings of a cluster's table and the environment.
pub(super) fn resolve(table: ClusterTable) -> Result<ClusterSettings, ServeError> {
    let said = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let secrets = ClusterSecrets {
        database_url: said("FLANKWATCH_DATABASE_URL"),
        nats_password: said("FLANKWATCH_NATS_PASSWORD"),
        nats_token: said("FLANKWATCH_NATS_TOKEN"),
        s3_access_key_id: said("FLANKWATCH_S3_ACCESS_KEY_ID"),
        s3_secret_access_key: said("FLANKWATCH_S3_SECRET_ACCESS_KEY"),
    };
    Ok(table.resolve(secrets)?)
}
