//! Which store the database and the raw objects are of, so that objects are never removed on the word of a
//! database that does not know them: one that is new, older, or another one's.
//!
//! Both carry a mark of a name and a generation. The generation rises first in the database and then among
//! the objects, at every start and while records come in, so that an older database is known by a lower one.

use std::sync::PoisonError;
use std::sync::atomic::Ordering;

use super::rows::get;
use super::{Objects, Store, StoreError, StoreMark};

impl Store {
    /// Why nothing is removed from the raw objects; none where they are those that the database knows.
    pub fn held(&self) -> Option<String> {
        self.inner.held.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Compares the marks of the database and of the objects, makes them where there are none, and begins a
    /// new generation where they agree.
    ///
    /// Error: [`StoreError::OtherStore`] where processes share the store, the objects are of another one, and
    /// that is refused.
    pub(super) async fn compare_marks(&self, refuses_others: bool) -> Result<(), StoreError> {
        if self.damage().is_some() {
            self.hold(Some("the database is damaged".to_owned()));
            return Ok(());
        }
        let among = self.on_objects(Objects::mark).await?;
        let mine = match self.database_mark().await? {
            Some(mine) => mine,
            None => self.new_database_mark().await?,
        };
        let among = match among {
            Some(among) => among,
            // Objects that no mark goes with are those of a database that is lost.
            None => {
                let is_empty = self.on_objects(Objects::is_empty).await?;
                let first = if is_empty || self.knows_objects().await? { mine.clone() } else { new_mark()? };
                self.on_objects(move |objects| objects.mark_first(&first)).await?
            }
        };
        if mine.store != among.store && self.is_shared() && refuses_others {
            return Err(StoreError::OtherStore { objects: among.store, database: mine.store });
        }
        self.hold(reason(&mine, &among));
        self.raise_generation().await
    }

    /// Compares the marks again before something is removed; returns why nothing may be.
    pub async fn check_marks(&self) -> Result<Option<String>, StoreError> {
        if self.held().is_some() {
            return Ok(self.held());
        }
        self.check_whole()?;
        let why = self.marks_differ().await?;
        // What was once found is not forgotten before the next start.
        if why.is_some() {
            self.hold(why);
        }
        Ok(self.held())
    }

    /// How the marks of the database and of the objects differ now.
    pub(super) async fn marks_differ(&self) -> Result<Option<String>, StoreError> {
        let among = self.on_objects(Objects::mark).await?;
        Ok(match (self.database_mark().await?, among) {
            (Some(mine), Some(among)) => reason(&mine, &among),
            _ => Some("the mark of the store is missing".to_owned()),
        })
    }

    /// Begins a new generation where something was written since the last one.
    pub async fn raise_generation_if_changed(&self) -> Result<(), StoreError> {
        if self.inner.is_changed.swap(false, Ordering::Relaxed) && self.check_marks().await?.is_none() {
            self.raise_generation().await?;
        }
        Ok(())
    }

    /// Takes the objects for those of the database as it is: what it does not know counts as not needed.
    pub async fn accept_objects(&self) -> Result<(), StoreError> {
        let (Some(mine), Some(among)) = (self.database_mark().await?, self.on_objects(Objects::mark).await?)
        else {
            return Ok(());
        };
        sqlx::query("UPDATE store_identity SET store = $1, generation = $2 WHERE one = 1")
            .bind(among.store.as_str())
            .bind(among.generation.max(mine.generation))
            .execute(self.write())
            .await?;
        self.hold(None);
        self.raise_generation().await
    }

    fn hold(&self, why: Option<String>) {
        if let Some(why) = &why {
            tracing::warn!(why, "nothing is removed from the raw recordings");
        }
        *self.inner.held.lock().unwrap_or_else(PoisonError::into_inner) = why;
    }

    async fn raise_generation(&self) -> Result<(), StoreError> {
        if self.held().is_some() || self.damage().is_some() {
            return Ok(());
        }
        sqlx::query("UPDATE store_identity SET generation = generation + 1 WHERE one = 1")
            .execute(self.write())
            .await?;
        if let Some(mark) = self.database_mark().await? {
            self.on_objects(move |objects| objects.set_mark(&mark)).await?;
        }
        Ok(())
    }

    /// The mark of the database; none of one that is new. Read where it is written: a replica may be behind.
    pub async fn database_mark(&self) -> Result<Option<StoreMark>, StoreError> {
        let row = sqlx::query("SELECT store, generation FROM store_identity WHERE one = 1")
            .fetch_optional(self.write())
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
            .execute(self.write())
            .await?;
        // Another process may have been first.
        Ok(self.database_mark().await?.unwrap_or(mark))
    }

    async fn knows_objects(&self) -> Result<bool, StoreError> {
        let row = sqlx::query("SELECT sha256 FROM raw_objects LIMIT 1").fetch_optional(self.read()).await?;
        Ok(row.is_some())
    }

    /// Does something with the objects on a thread that may block.
    pub(super) async fn on_objects<T: Send + 'static>(
        &self,
        work: impl FnOnce(&Objects) -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let store = self.clone();
        let done = tokio::task::spawn_blocking(move || work(store.objects())).await;
        done.unwrap_or(Err(StoreError::Outdated("the thread that works on objects")))
    }
}

fn new_mark() -> Result<StoreMark, StoreError> {
    let mut chance = [0; 8];
    getrandom::fill(&mut chance).map_err(|source| {
        super::objects::file_error("name", "the store".as_ref(), std::io::Error::other(source.to_string()))
    })?;
    Ok(StoreMark { store: hex::encode(chance), generation: 0 })
}

fn reason(mine: &StoreMark, among: &StoreMark) -> Option<String> {
    if mine.store != among.store {
        return Some(format!(
            "the raw recordings are those of store {}, and the database is of store {}: it is new or another one; \
             `flankwatch rebuild` takes in what it does not know",
            among.store, mine.store
        ));
    }
    (mine.generation < among.generation).then(|| {
        format!(
            "the raw recordings are of generation {}, and the database is of generation {}: it is older than they are; \
             `flankwatch rebuild` takes in what it does not know",
            among.generation, mine.generation
        )
    })
}
