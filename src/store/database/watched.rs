//! Connections that record the damage of the database that any of their statements reports.

use std::ops::{Deref, DerefMut};
use std::path::PathBuf;

use futures_util::future::BoxFuture;
use futures_util::stream::BoxStream;
use futures_util::{StreamExt, TryFutureExt, TryStreamExt};
use sqlx::any::{AnyQueryResult, AnyRow, AnyStatement, AnyTypeInfo};
use sqlx::pool::PoolConnection;
use sqlx::{Any, AnyConnection, AnyPool, Describe, Either, Error, Execute, Executor, Transaction};

use super::integrity::{Damage, damage_in};

/// Where damage of a database file is recorded.
#[derive(Debug, Clone)]
pub(in crate::store) struct Watch {
    pub(in crate::store) damage: Damage,
    pub(in crate::store) path: PathBuf,
}

/// A pool whose statements are watched.
#[derive(Debug, Clone)]
pub(in crate::store) struct WatchedPool {
    pool: AnyPool,
    /// `None` for a database that has no file, or that is only read.
    watch: Option<Watch>,
}

/// A connection in a transaction, whose statements are watched.
#[derive(Debug)]
pub(in crate::store) struct WatchedConnection {
    transaction: Transaction<'static, Any>,
    watch: Option<Watch>,
}

/// A transaction whose statements are watched. It is rolled back unless it is committed.
#[derive(Debug)]
pub(in crate::store) struct WatchedTransaction(WatchedConnection);

fn report_damage(watch: Option<&Watch>, error: &Error) {
    if let Some(Watch { damage, path }) = watch
        && let Some(found) = damage_in(error)
    {
        damage.report(&found, Some(path));
    }
}

impl WatchedPool {
    pub(in crate::store) fn new(pool: AnyPool, watch: Option<Watch>) -> Self {
        Self { pool, watch }
    }

    pub(in crate::store) async fn begin(&self) -> Result<WatchedTransaction, Error> {
        self.watched(self.pool.begin().await)
    }

    /// Begins a transaction with this statement.
    pub(in crate::store) async fn begin_with(
        &self,
        statement: &'static str,
    ) -> Result<WatchedTransaction, Error> {
        self.watched(self.pool.begin_with(statement).await)
    }

    /// A connection whose statements are not watched.
    pub(in crate::store) async fn acquire(&self) -> Result<PoolConnection<Any>, Error> {
        self.pool.acquire().await
    }

    pub(in crate::store) async fn close(&self) {
        self.pool.close().await;
    }

    pub(in crate::store) fn is_closed(&self) -> bool {
        self.pool.is_closed()
    }

    fn watched(&self, begun: Result<Transaction<'static, Any>, Error>) -> Result<WatchedTransaction, Error> {
        let watch = self.watch.clone();
        let begun = begun.inspect_err(|error| report_damage(watch.as_ref(), error));
        begun.map(|transaction| WatchedTransaction(WatchedConnection { transaction, watch }))
    }

    fn parts(&self) -> (&AnyPool, Option<&Watch>) {
        (&self.pool, self.watch.as_ref())
    }
}

impl WatchedConnection {
    fn parts(&mut self) -> (&mut AnyConnection, Option<&Watch>) {
        (&mut self.transaction, self.watch.as_ref())
    }
}

impl WatchedTransaction {
    pub(in crate::store) async fn commit(self) -> Result<(), Error> {
        let WatchedConnection { transaction, watch } = self.0;
        transaction.commit().await.inspect_err(|error| report_damage(watch.as_ref(), error))
    }
}

impl Deref for WatchedTransaction {
    type Target = WatchedConnection;

    fn deref(&self) -> &WatchedConnection {
        &self.0
    }
}

impl DerefMut for WatchedTransaction {
    fn deref_mut(&mut self) -> &mut WatchedConnection {
        &mut self.0
    }
}

/// Implements [`Executor`] for a reference to something that has a connection and a watch.
macro_rules! watched_executor {
    ($type:ty) => {
        impl<'c> Executor<'c> for $type {
            type Database = Any;

            fn fetch_many<'e, 'q: 'e, E>(
                self,
                query: E,
            ) -> BoxStream<'e, Result<Either<AnyQueryResult, AnyRow>, Error>>
            where
                'c: 'e,
                E: 'q + Execute<'q, Any>,
            {
                let (connection, watch) = self.parts();
                connection.fetch_many(query).inspect_err(move |error| report_damage(watch, error)).boxed()
            }

            fn fetch_optional<'e, 'q: 'e, E>(self, query: E) -> BoxFuture<'e, Result<Option<AnyRow>, Error>>
            where
                'c: 'e,
                E: 'q + Execute<'q, Any>,
            {
                let (connection, watch) = self.parts();
                Box::pin(
                    connection.fetch_optional(query).inspect_err(move |error| report_damage(watch, error)),
                )
            }

            fn prepare_with<'e, 'q: 'e>(
                self,
                sql: &'q str,
                parameters: &'e [AnyTypeInfo],
            ) -> BoxFuture<'e, Result<AnyStatement<'q>, Error>>
            where
                'c: 'e,
            {
                let (connection, watch) = self.parts();
                Box::pin(
                    connection
                        .prepare_with(sql, parameters)
                        .inspect_err(move |error| report_damage(watch, error)),
                )
            }

            fn describe<'e, 'q: 'e>(self, sql: &'q str) -> BoxFuture<'e, Result<Describe<Any>, Error>>
            where
                'c: 'e,
            {
                let (connection, watch) = self.parts();
                Box::pin(connection.describe(sql).inspect_err(move |error| report_damage(watch, error)))
            }
        }
    };
}

watched_executor!(&'c WatchedPool);
watched_executor!(&'c mut WatchedConnection);

#[cfg(test)]
mod tests {
    use crate::store::{Store, StoreError, StoreSettings};

    #[tokio::test]
    async fn damage_that_any_statement_reports_stops_every_write() {
        for is_transaction in [false, true] {
            let folder = tempfile::tempdir().unwrap();
            let store = Store::open(&StoreSettings::Folder(folder.path().to_owned())).await.unwrap();
            store.save_replay(1, "a replay").await.unwrap();
            let lost = sqlx::query("SELECT * FROM lost");
            let error = if is_transaction {
                let mut transaction = store.write().unwrap().begin().await.unwrap();
                lost.execute(&mut *transaction).await.unwrap_err()
            } else {
                lost.fetch_optional(store.read()).await.map(|_| ()).unwrap_err()
            };
            assert!(error.to_string().contains("no such table"), "{error}");
            assert!(store.damage().unwrap().contains("no such table: lost"));
            let refused = store.save_replay(2, "another replay").await.unwrap_err();
            assert!(matches!(refused, StoreError::DatabaseDamaged { .. }), "{refused}");
            assert_eq!(store.saved_replays().await.unwrap().len(), 1);
        }
    }
}
