use std::path::Path;

use super::*;

/// The stores under test: SQLite, and PostgreSQL if `FLANKWATCH_TEST_DATABASE` is set.
async fn stores(folder: &Path) -> Vec<Store> {
    #[cfg_attr(not(feature = "postgres"), expect(unused_mut, reason = "there is one"))]
    let mut stores = vec![Store::open(&folder.into()).await.unwrap()];
    #[cfg(feature = "postgres")]
    if let Ok(url) = std::env::var("FLANKWATCH_TEST_DATABASE") {
        use sqlx::{AnyConnection, Connection};
        let schema = format!("streams_{}", std::process::id());
        let mut connection = AnyConnection::connect(&url).await.unwrap();
        let made = format!("DROP SCHEMA IF EXISTS {schema} CASCADE; CREATE SCHEMA {schema}");
        sqlx::raw_sql(&made).execute(&mut connection).await.unwrap();
        let objects = crate::store::ObjectsSettings::Folder(folder.join("shared"));
        let url = format!("{url}?options[search_path]={schema}");
        let settings = crate::store::SharedSettings::new(url, objects);
        stores.push(Store::open(&crate::store::StoreSettings::Shared(settings)).await.unwrap());
    }
    stores
}

async fn drop_schema(store: &Store) {
    if store.is_shared() {
        let drop = format!("DROP SCHEMA streams_{} CASCADE", std::process::id());
        sqlx::query(&drop).execute(store.write().unwrap()).await.unwrap();
    }
    store.close().await;
}

fn frames(first: u64, frames: u64) -> JournalEntry {
    let bytes = (first..first + frames).flat_map(|k| (k as i16).to_le_bytes()).collect();
    JournalEntry::Frames { first, time_ns: Some(7), bytes }
}

async fn append(store: &Store, stream: StreamKey, number: u64, pending: usize) -> bool {
    let entries = [frames(number * 10, 10), JournalEntry::Event(Bytes::from_static(b"note"))];
    let (first, end) = (number * 10, number * 10 + 10);
    let append = StreamAppend { number, first, end, pending, entries: &entries };
    store.append_to_stream(stream, &append).await.unwrap()
}

fn level(second: u64) -> TimedLevel {
    let channels = vec![crate::recording::stream::ChannelLevel { rms: second as f32, peak: 2.0 }];
    let level = crate::recording::stream::Level { first: second * 10, frames: 10, channels };
    TimedLevel { time_ns: second as i64, level }
}

#[tokio::test]
async fn entries_are_appended_once_and_removed_with_a_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    for store in stores(folder.path()).await {
        let spec = toml::from_str("id = \"pump\"\nshaft = { speed_hz = 10.0 }").unwrap();
        let (pump, now) = (AssetId::new("pump").unwrap(), Timestamp::now());
        let created_at = store.insert_asset(&spec, None, now).await.unwrap().created_at;
        let state = Bytes::from_static(b"before");
        let create =
            async |name: &str, created_at| store.create_stream(&pump, created_at, name, &state, 2).await;
        assert!(create("main", created_at).await.unwrap() && create("main", created_at).await.unwrap());
        assert!(create("other", created_at).await.unwrap());
        assert!(!create("third", created_at).await.unwrap());
        let error = create("other", Timestamp::UNIX_EPOCH).await.unwrap_err();
        assert!(matches!(error, StoreError::AssetUnknown(_)), "{error}");
        assert_eq!(store.stream_names(&pump).await.unwrap(), ["main", "other"]);

        let (stream, checkpoint, found) = store.stream_checkpoint(&pump, "main").await.unwrap().unwrap();
        assert_eq!((checkpoint, found), (0, state.clone()));
        for number in 1..=4 {
            assert!(append(&store, stream, number, 0).await);
            assert!(!append(&store, stream, number, 0).await);
        }
        let version = async || store.stream_version(stream).await.unwrap();
        assert_eq!(version().await, Some(StreamVersion { checkpoint: 0, last: 4 }));
        let numbers = async |after| {
            let entries = store.stream_entries(stream, after).await.unwrap();
            entries.map(|entries| entries.iter().map(|(number, _)| *number).collect::<Vec<_>>())
        };
        assert_eq!(numbers(2).await, Some(vec![3, 4]));
        let read = store.stream_frames(stream, 15, 20, 2).await.unwrap().unwrap();
        assert_eq!(read, (15..35_i16).flat_map(i16::to_le_bytes).collect::<Vec<u8>>());
        assert_eq!(store.stream_frames(stream, 45, 20, 2).await.unwrap(), None);

        let whole = store.stream_bytes(stream).await.unwrap();
        let levels = [level(1), level(2)];
        let checkpoint = |previous, number, needed_from, levels| StreamCheckpoint {
            previous,
            number,
            state: Bytes::from_static(b"after"),
            levels,
            needed_from,
        };
        let put = async |checkpoint| store.store_stream_checkpoint(stream, &checkpoint).await.unwrap();
        assert!(put(checkpoint(0, 4, 30, &levels)).await);
        assert!(!put(checkpoint(0, 4, 30, &levels)).await);
        assert_eq!(version().await, Some(StreamVersion { checkpoint: 4, last: 4 }));
        assert_eq!((numbers(0).await, numbers(2).await), (None, Some(vec![3, 4])));
        assert_eq!(store.stream_bytes(stream).await.unwrap(), whole / 2);
        // The number of a removed row is not free again.
        assert!(!append(&store, stream, 1, 0).await);
        assert!(append(&store, stream, 5, 3).await);
        assert!(put(checkpoint(4, 5, u64::MAX, &[])).await);
        assert_eq!(version().await, Some(StreamVersion { checkpoint: 5, last: 5 }));
        assert_eq!(store.stream_levels(stream, 1, i64::MIN, i64::MAX).await.unwrap(), levels);
        assert_eq!(store.stream_levels(stream, 1, 2, 9).await.unwrap(), levels[1..]);

        let main = || vec![(pump.clone(), "main".to_owned())];
        assert_eq!(store.uncut_streams(now, 10).await.unwrap(), main());
        assert!(store.begin_cutting(stream, 1, false, now).await.unwrap());
        assert!(store.begin_cutting(stream, 1, false, now).await.unwrap());
        assert!(!store.begin_cutting(stream, 2, false, now).await.unwrap());
        assert_eq!(store.uncut_streams(now, 10).await.unwrap(), []);
        assert!(store.begin_cutting(stream, 2, true, now).await.unwrap());
        store.end_cutting(1, None).await.unwrap();
        assert_eq!(store.uncut_streams(now, 10).await.unwrap(), []);
        store.end_cutting(2, None).await.unwrap();
        assert_eq!(store.uncut_streams(now, 10).await.unwrap(), main());

        let mark = store.descriptions_mark().await.unwrap();
        store.delete_asset(&pump, mark).await.unwrap();
        assert!(!store.has_stream(&pump, "main").await.unwrap());
        assert_eq!(version().await, None);
        assert!(!append(&store, stream, 6, 0).await);
        drop_schema(&store).await;
    }
}
