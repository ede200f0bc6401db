//! Write transactions on assets and channels, and their row locks.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use jiff::Timestamp;
use serde_json::Value;

use super::assets::{asset_of, channel_of};
use super::database::rows::{any_of, excluded, placeholders, rows_of_placeholders, to_ns};
use super::database::schema::Dialect;
use super::database::watched::WatchedTransaction;
use super::layouts::LayoutCache;
use super::{Asset, ChannelSummary, Recipients, Store, StoreError};
use crate::asset::AssetId;

/// Maximum number of rows written by one statement.
pub(super) const ROWS_PER_STATEMENT: usize = 64;

/// The columns of a channel's row that change.
const SUMMARY: &str = "segments, first_start_ns, last_start_ns, last_segment_id, revision, rewritten_revision, analysis_generation, wear_generation, \
    newest_generation, analysis_key, feature_key, fold_key, must_fold, leftovers, next_analysis_generation, next_analysis_key, \
    next_wear_generation, maker_until_ns, changed_from_ns, changed_from_id";

/// A transaction on any number of channels. Nothing is stored until [`commit`](Self::commit) returns; then
/// everything is durable.
///
/// On a shared store rows are locked in this order to avoid deadlocks: assets by name, then channels by asset
/// and name, then dependent rows.
pub struct Transaction {
    pub(super) inner: WatchedTransaction,
    pub(super) dialect: Dialect,
    pub(super) recipients: Arc<Recipients>,
    pub(super) layouts: Arc<LayoutCache>,
    /// Layouts that this transaction stores.
    pub(super) new_layouts: HashMap<i64, Arc<Value>>,
}

impl Store {
    /// Begins a transaction; waits for a write connection.
    pub async fn begin(&self) -> Result<Transaction, StoreError> {
        self.inner.is_changed.store(true, Ordering::Relaxed);
        Ok(Transaction {
            inner: self.write()?.begin().await?,
            dialect: self.dialect(),
            recipients: self.recipients(),
            layouts: Arc::clone(&self.inner.layouts),
            new_layouts: HashMap::new(),
        })
    }
}

impl Transaction {
    /// Reads an asset; its description and events are locked against changes until the end of the
    /// transaction.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`] if it is deleted.
    pub async fn asset(&mut self, id: &AssetId) -> Result<Asset, StoreError> {
        let mut found = self.assets(&[id]).await?;
        found.remove(id).ok_or_else(|| StoreError::AssetUnknown(id.clone()))
    }

    /// Reads assets; their descriptions and events are locked against changes until the end of the
    /// transaction.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`] if one is deleted.
    pub async fn assets(&mut self, ids: &[&AssetId]) -> Result<HashMap<AssetId, Asset>, StoreError> {
        let text = format!(
            "SELECT * FROM assets WHERE id IN ({}) ORDER BY id{}",
            placeholders(1, ids.len()),
            self.dialect.for_share()
        );
        let query = sqlx::query(&text).persistent(self.dialect.caches_statement(ids.len()));
        let query = ids.iter().fold(query, |query, id| query.bind(id.as_str()));
        let rows = query.fetch_all(&mut *self.inner).await?;
        let assets = rows.iter().map(|row| asset_of(row).map(|asset| (asset.spec.id.clone(), asset)));
        let assets: HashMap<AssetId, Asset> = assets.collect::<Result<_, StoreError>>()?;
        match ids.iter().find(|id| !assets.contains_key(**id)) {
            Some(gone) => Err(StoreError::AssetUnknown((*gone).clone())),
            None => Ok(assets),
        }
    }

    /// Reads and locks an asset, so that no other transaction changes it or adds a channel to it before the
    /// end of this one; marks it as changed.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`] if it is deleted.
    pub(super) async fn lock_asset(&mut self, id: &AssetId) -> Result<Asset, StoreError> {
        // Every change of assets locks the counter before the asset, so that changes of several assets cannot
        // deadlock.
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'asset_revision'")
            .execute(&mut *self.inner)
            .await?;
        let text = format!("SELECT * FROM assets WHERE id = $1{}", self.dialect.for_update());
        let row = sqlx::query(&text).bind(id.as_str()).fetch_optional(&mut *self.inner).await?;
        let asset = asset_of(&row.ok_or_else(|| StoreError::AssetUnknown(id.clone()))?)?;
        sqlx::query("UPDATE assets SET revision = (SELECT value FROM counters WHERE name = 'asset_revision') WHERE id = $1")
            .bind(id.as_str())
            .execute(&mut *self.inner)
            .await?;
        Ok(asset)
    }

    /// Reads and locks the channels of these names, in this order, of existing assets; creates missing ones.
    pub async fn channels(&mut self, names: &[(&AssetId, &str)]) -> Result<Vec<ChannelSummary>, StoreError> {
        let mut found = self.lock_existing_channels(names).await?;
        let key = |&(asset, name): &(&AssetId, &str)| (asset.clone(), name.to_owned());
        let missing: Vec<_> = names.iter().copied().filter(|name| !found.contains_key(&key(name))).collect();
        for (asset, name) in &missing {
            self.new_channel(asset, name).await?;
        }
        found.extend(self.lock_existing_channels(&missing).await?);
        let in_order = names.iter().map(|name| {
            let gone = || StoreError::AssetUnknown(name.0.clone());
            found.remove(&key(name)).ok_or_else(gone)
        });
        in_order.collect()
    }

    /// Reads and locks those of these channels that exist.
    async fn lock_existing_channels(
        &mut self,
        names: &[(&AssetId, &str)],
    ) -> Result<HashMap<(AssetId, String), ChannelSummary>, StoreError> {
        let mut found = HashMap::new();
        for chunk in names.chunks(ROWS_PER_STATEMENT) {
            let which = any_of(chunk.len(), &["asset_id =", "name ="]);
            let text = format!(
                "SELECT * FROM channels WHERE {which} ORDER BY asset_id, name{}",
                self.dialect.for_update()
            );
            let query = sqlx::query(&text).persistent(self.dialect.caches_statement(chunk.len()));
            let query =
                chunk.iter().fold(query, |query, (asset, name)| query.bind(asset.as_str()).bind(*name));
            for row in query.fetch_all(&mut *self.inner).await? {
                let channel = channel_of(&row)?;
                found.insert((channel.asset_id.clone(), channel.channel.clone()), channel);
            }
        }
        Ok(found)
    }

    /// Creates a channel unless another process has created it in the meantime.
    async fn new_channel(&mut self, asset: &AssetId, channel: &str) -> Result<(), StoreError> {
        sqlx::query("UPDATE counters SET value = value + 1 WHERE name = 'channel_no'")
            .execute(&mut *self.inner)
            .await?;
        sqlx::query(
            "INSERT INTO channels (channel_no, asset_id, name, segments, revision, rewritten_revision)
             SELECT value, $1, $2, 0, 0, 0 FROM counters WHERE name = 'channel_no'
             ON CONFLICT (asset_id, name) DO NOTHING",
        )
        .bind(asset.as_str())
        .bind(channel)
        .execute(&mut *self.inner)
        .await?;
        Ok(())
    }

    /// Reads and locks the current state of a channel that was read before.
    ///
    /// # Errors
    /// [`StoreError::AssetUnknown`] if it is deleted with its asset.
    pub async fn lock_channel(&mut self, channel: &ChannelSummary) -> Result<ChannelSummary, StoreError> {
        let text = format!("SELECT * FROM channels WHERE channel_no = $1{}", self.dialect.for_update());
        let row = sqlx::query(&text).bind(channel.channel_no).fetch_optional(&mut *self.inner).await?;
        let gone = || StoreError::AssetUnknown(channel.asset_id.clone());
        channel_of(&row.ok_or_else(gone)?)
    }

    /// Sets a channel's summary; `rewritten` says that estimates of earlier segments changed.
    pub async fn set_channel(
        &mut self,
        channel: &mut ChannelSummary,
        rewritten: bool,
    ) -> Result<(), StoreError> {
        channel.count_change(rewritten);
        self.set_channels(&[&*channel]).await
    }

    /// Sets the summaries of channels whose rows this transaction has locked.
    pub(super) async fn set_channels(&mut self, channels: &[&ChannelSummary]) -> Result<(), StoreError> {
        let optional_ns = |time: Option<Timestamp>| time.map(to_ns).transpose();
        for chunk in channels.chunks(ROWS_PER_STATEMENT) {
            // All of them exist: this is a bulk update in a form that both databases support.
            let text = format!(
                "INSERT INTO channels (channel_no, asset_id, name, {SUMMARY}) VALUES {} ON CONFLICT (channel_no) DO UPDATE SET {}",
                rows_of_placeholders(chunk.len(), 3 + SUMMARY.split(", ").count()),
                excluded(SUMMARY)
            );
            let mut query = sqlx::query(&text);
            for channel in chunk {
                query = query
                    .bind(channel.channel_no)
                    .bind(channel.asset_id.as_str())
                    .bind(channel.channel.as_str())
                    .bind(i64::try_from(channel.segments).unwrap_or(i64::MAX))
                    .bind(optional_ns(channel.first_start_time)?)
                    .bind(optional_ns(channel.last_start_time)?)
                    .bind(channel.last_segment.as_ref().map(|id| id.0.as_str()))
                    .bind(channel.revision)
                    .bind(channel.rewritten_revision)
                    .bind(channel.analysis_generation)
                    .bind(channel.wear_generation)
                    .bind(channel.newest_generation)
                    .bind(&*channel.keys.analysed.analysis)
                    .bind(&*channel.keys.analysed.feature)
                    .bind(channel.keys.fold.as_str())
                    .bind(i64::from(channel.must_fold))
                    .bind(i64::from(channel.leftovers))
                    .bind(channel.next_analysis.as_ref().map(|(generation, _)| *generation))
                    .bind(channel.next_analysis.as_ref().map(|(_, key)| key.as_str()))
                    .bind(channel.next_wear)
                    .bind(optional_ns(channel.writer_lease_until)?)
                    .bind(optional_ns(channel.changed_from.as_ref().map(|key| key.start_time))?)
                    .bind(channel.changed_from.as_ref().map(|key| key.id.0.as_str()));
            }
            query.persistent(self.dialect.caches_statement(chunk.len())).execute(&mut *self.inner).await?;
        }
        Ok(())
    }

    /// Commits the transaction.
    pub async fn commit(self) -> Result<(), StoreError> {
        self.inner.commit().await?;
        self.layouts.add(self.new_layouts);
        Ok(())
    }
}
