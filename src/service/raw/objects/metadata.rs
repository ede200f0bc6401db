//! The metadata of assets beside the raw objects, and the tombstones of removed records.

use super::{Age, RawObjects};
use crate::asset::AssetId;
use crate::service::error::ServiceError;
use crate::service::workers::blocking;
use crate::store::{AssetMetadata, StoreError, Tombstone};

impl RawObjects {
    /// Writes the metadata of an asset beside the raw objects, or removes it if the asset is deleted.
    ///
    /// An existing metadata file is kept while removals are suspended, that is, if the objects may not belong
    /// to the database.
    pub(crate) async fn write_asset_metadata(&self, id: &AssetId) -> Result<(), ServiceError> {
        let _guard = self.writing_metadata.lock().await;
        let mut metadata = self.asset_metadata(id).await?;
        loop {
            self.put_asset_metadata(id, metadata.clone()).await?;
            // Another process may have changed the asset and written its metadata file a moment before this
            // one.
            let now = if self.store.is_shared() { self.asset_metadata(id).await? } else { return Ok(()) };
            if now == metadata {
                return Ok(());
            }
            metadata = now;
        }
    }

    /// The metadata of an asset; `None` if it is deleted.
    async fn asset_metadata(&self, id: &AssetId) -> Result<Option<AssetMetadata>, ServiceError> {
        match self.store.asset(id).await {
            Ok(asset) => Ok(Some(AssetMetadata {
                spec: asset.spec,
                created_at: asset.created_at,
                updated_at: asset.updated_at,
                maintenance: self.store.maintenance(id).await?,
                excluded: self.store.excluded(id).await?,
            })),
            Err(StoreError::AssetUnknown(_)) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    async fn put_asset_metadata(
        &self,
        id: &AssetId,
        metadata: Option<AssetMetadata>,
    ) -> Result<(), ServiceError> {
        let (store, id) = (self.store.clone(), id.clone());
        let write = move || {
            let objects = store.objects();
            if store.removal_hold().is_some() && objects.asset_metadata(&id)?.is_some() {
                return Ok(());
            }
            match &metadata {
                Some(metadata) => objects.put_asset_metadata(metadata),
                None => objects.remove_asset_metadata(&id),
            }
        };
        Ok(blocking("write the metadata of an asset", write).await??)
    }

    /// Writes the metadata of an asset whose change is stored; after a failure the next start writes it.
    pub(crate) async fn update_asset_metadata(&self, id: &AssetId) {
        if let Err(error) = self.write_asset_metadata(id).await {
            tracing::warn!(asset = %id, %error, "failed to write the metadata of an asset beside its raw recordings");
        }
    }

    /// Removes the metadata of assets that were deleted by a process which ended before it removed them; on a
    /// shared store only metadata files that no process can have written recently.
    pub(super) async fn remove_stale_asset_metadata(&self) -> Result<(), ServiceError> {
        let store = self.store.clone();
        let list = move || Ok::<_, StoreError>((store.objects().all_asset_metadata()?, Age::now(&store)?));
        let (all, age) = blocking("read the metadata of assets", list).await??;
        for metadata in
            all.iter().filter(|metadata| age.is_old_enough(metadata.created_at.max(metadata.updated_at)))
        {
            if let Err(StoreError::AssetUnknown(id)) = self.store.asset(&metadata.spec.id).await {
                tracing::info!(asset = %id, "removing the metadata of a deleted asset");
                self.write_asset_metadata(&id).await?;
            }
        }
        Ok(())
    }

    /// Writes a tombstone of removed records beside the raw objects, so that a rebuild skips them. On a
    /// shared store their dead-letter count is raised, so that the queue accepts them if they are sent again.
    pub(crate) async fn write_tombstone(&self, tombstone: Tombstone) -> Result<(), ServiceError> {
        if self.store.is_shared() {
            let letter = i64::try_from(tombstone.removed_at.as_nanosecond()).unwrap_or(i64::MAX);
            for segment in &tombstone.segments {
                self.store.count_dead_letter(segment, letter.wrapping_neg(), tombstone.removed_at).await?;
            }
        }
        let store = self.store.clone();
        Ok(blocking("write a tombstone", move || store.objects().put_tombstone(&tombstone)).await??)
    }

    /// Takes records that are stored out of the tombstones: their removal failed, or they were sent again. On
    /// a shared store only out of those old enough that no process is still removing the records. The caller
    /// holds the [`exclusive`](Self::exclusive) lock.
    pub(crate) async fn forget_failed_removals(&self) -> Result<(), ServiceError> {
        // An older database has records that were removed since.
        if self.store.removal_hold().is_some() {
            return Ok(());
        }
        let store = self.store.clone();
        let list = move || -> Result<_, StoreError> {
            let tombstones = store.objects().tombstones()?;
            Ok(tombstones.into_iter().flat_map(|tombstone| tombstone.segments).collect::<Vec<_>>())
        };
        let removed = blocking("read the tombstones", list).await??;
        let stored = self.store.known_segments(&removed).await?;
        if stored.is_empty() {
            return Ok(());
        }
        let store = self.store.clone();
        let forget = move || {
            let age = store.is_shared().then(|| Age::now(&store)).transpose()?;
            let is_old_enough = |removed_at| age.as_ref().is_none_or(|age| age.is_old_enough(removed_at));
            store.objects().withdraw_tombstones(&stored, is_old_enough)
        };
        Ok(blocking("write the tombstones", forget).await??)
    }
}
