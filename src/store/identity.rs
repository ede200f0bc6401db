//! The identity of the store, which protects raw objects from removal by a database that does not know them:
//! a new or older one, or that of another store.
//!
//! The database and the objects both carry a mark: an identifier and a generation. The generation is raised
//! first in the database and then among the objects, at every start and while records are stored, so that a
//! lower generation identifies an older database.

use std::sync::PoisonError;
use std::sync::atomic::Ordering;

use super::database::rows::get;
use super::{Objects, Store, StoreError, StoreMark};

impl Store {
    /// Why removals from the raw objects are suspended; `None` if the marks agree.
    pub fn removal_hold(&self) -> Option<String> {
        self.inner.removal_hold.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Compares the marks of the database and of the objects, creates missing ones, and raises the generation
    /// if they agree.
    ///
    /// # Errors
    /// [`StoreError::OtherStore`] if the store is shared, the objects belong to another store, and
    /// `refuses_others`.
    pub(super) async fn compare_marks(&self, refuses_others: bool) -> Result<(), StoreError> {
        if self.damage().is_some() {
            self.set_removal_hold(Some("the database is damaged".to_owned()));
            return Ok(());
        }
        let among = self.on_objects(Objects::mark).await?;
        let mine = match self.database_mark().await? {
            Some(mine) => mine,
            None => self.new_database_mark().await?,
        };
        let among = match among {
            Some(among) => among,
            // Objects without a mark belong to a lost database.
            None => {
                let is_empty = self.on_objects(Objects::is_empty).await?;
                let first = if is_empty || self.knows_objects().await? { mine.clone() } else { new_mark()? };
                self.on_objects(move |objects| objects.mark_first(&first)).await?
            }
        };
        if mine.store != among.store && self.is_shared() && refuses_others {
            return Err(StoreError::OtherStore { objects: among.store, database: mine.store });
        }
        let why = reason(&mine, &among);
        match refuses_others {
            true => self.set_removal_hold(why),
            // A rebuild is what the reason asks for.
            false => self.hold_removals(why),
        }
        self.raise_generation().await
    }

    /// Compares the marks again before a removal; returns why removals are suspended, if they are.
    pub async fn check_marks(&self) -> Result<Option<String>, StoreError> {
        if self.removal_hold().is_some() {
            return Ok(self.removal_hold());
        }
        self.check_whole()?;
        let why = self.marks_differ().await?;
        // A difference, once found, suspends removals until the next start.
        if why.is_some() {
            self.set_removal_hold(why);
        }
        Ok(self.removal_hold())
    }

    /// How the current marks of the database and of the objects differ.
    pub(super) async fn marks_differ(&self) -> Result<Option<String>, StoreError> {
        let among = self.on_objects(Objects::mark).await?;
        Ok(match (self.database_mark().await?, among) {
            (Some(mine), Some(among)) => reason(&mine, &among),
            _ => Some("the mark of the store is missing".to_owned()),
        })
    }

    /// Raises the generation if something was written since it was last raised.
    pub async fn raise_generation_if_changed(&self) -> Result<(), StoreError> {
        if self.inner.is_changed.swap(false, Ordering::Relaxed) && self.check_marks().await?.is_none() {
            self.raise_generation().await?;
        }
        Ok(())
    }

    /// Accepts the objects as those of the current database: objects that it does not reference count as
    /// unreferenced.
    pub async fn accept_objects(&self) -> Result<(), StoreError> {
        let (Some(mine), Some(among)) = (self.database_mark().await?, self.on_objects(Objects::mark).await?)
        else {
            return Ok(());
        };
        sqlx::query("UPDATE store_identity SET store = $1, generation = $2 WHERE one = 1")
            .bind(among.store.as_str())
            .bind(among.generation.max(mine.generation))
            .execute(self.write()?)
            .await?;
        self.set_removal_hold(None);
        self.raise_generation().await
    }

    fn set_removal_hold(&self, why: Option<String>) {
        if let Some(why) = &why {
            tracing::warn!(why, "suspended the removal of raw recordings");
        }
        self.hold_removals(why);
    }

    fn hold_removals(&self, why: Option<String>) {
        *self.inner.removal_hold.lock().unwrap_or_else(PoisonError::into_inner) = why;
    }

    async fn raise_generation(&self) -> Result<(), StoreError> {
        if self.removal_hold().is_some() || self.damage().is_some() {
            return Ok(());
        }
        sqlx::query("UPDATE store_identity SET generation = generation + 1 WHERE one = 1")
            .execute(self.write()?)
            .await?;
        if let Some(mark) = self.database_mark().await? {
            self.on_objects(move |objects| objects.set_mark(&mark)).await?;
        }
        Ok(())
    }

    /// The mark of the database; `None` for a new one. Read through the write connection, because a replica
    /// may be behind.
    pub async fn database_mark(&self) -> Result<Option<StoreMark>, StoreError> {
        let row = sqlx::query("SELECT store, generation FROM store_identity WHERE one = 1")
            .fetch_optional(&self.inner.database.write)
            .await?;
        let mark = |row| -> Result<StoreMark, StoreError> {
            Ok(StoreMark { store: get(&row, "store")?, generation: get(&row, "generation")? })
        };
        row.map(mark).transpose()
    }

    async fn new_database_mark(&self) -> Result<StoreMark, StoreError> {
        let mark = new_mark()?;
        sqlx::query("INSERT INTO store_identity (one, store, generation) VALUES (1, $1, $2) ON CONFLICT (one) DO NOTHING")
            .bind(mark.store.as_str())
            .bind(mark.generation)
            .execute(self.write()?)
            .await?;
        // Another process may have created it first.
        Ok(self.database_mark().await?.unwrap_or(mark))
    }

    async fn knows_objects(&self) -> Result<bool, StoreError> {
        let row = sqlx::query("SELECT sha256 FROM raw_objects LIMIT 1").fetch_optional(self.read()).await?;
        Ok(row.is_some())
    }

    /// Runs `work` on the objects on a blocking thread.
    pub(super) async fn on_objects<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Objects) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let store = self.clone();
        let done = tokio::task::spawn_blocking(move || work(store.objects())).await;
        done.unwrap_or(Err(StoreError::ThreadLost))
    }
}

fn new_mark() -> Result<StoreMark, StoreError> {
    let mut random = [0; 8];
    getrandom::fill(&mut random).map_err(|source| {
        let source = std::io::Error::other(source.to_string());
        super::objects::file_error("get a random number for", "the store".as_ref(), source)
    })?;
    Ok(StoreMark { store: hex::encode(random), generation: 0 })
}

/// How the mark of a database differs from that of objects, so that it is not theirs or older.
pub(super) fn reason(mine: &StoreMark, among: &StoreMark) -> Option<String> {
    if mine.store != among.store {
        return Some(format!(
            "the raw recordings belong to store {}, the database belongs to store {}: the database is new or belongs to another store; \
                         add the missing records with `flankwatch rebuild`",
            among.store, mine.store
        ));
    }
    (mine.generation < among.generation).then(|| {
        format!(
            "the raw recordings have generation {}, the database has generation {}: the database is older than the recordings; \
                         add the missing records with `flankwatch rebuild`",
            among.generation, mine.generation
        )
    })
}
