//! The complete service: assembly, start and stop.

pub(super) mod connections;
pub(super) mod drain;
pub(super) mod head;
pub(super) mod limits;
pub(super) mod start_error;
pub(super) mod traffic;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio::sync::{RwLock, oneshot};
use tokio::task::JoinHandle;

use super::access::client::ClientLimiter;
use super::access::tokens::Tokens;
use super::access::{Access, AuthPolicy};
use super::app::App;
use super::events::ring::EventRing;
use super::metrics::requests::Measurements;
use super::router::router;
use super::uploads::resumable;
use crate::library::GridSettings;
use crate::service::{Clock, Role, Service, ServiceFolders, SharedEvents, WorkLimits, WorkQueue};
use crate::settings::SettingError;
use crate::store::{Recipients, Store, StoreSettings};
use connections::TlsFiles;
use limits::HttpLimits;
use start_error::StartError;

/// Time for the database to close after everything else has ended.
const CLOSING: std::time::Duration = std::time::Duration::from_secs(2);

/// Configuration of the service.
#[derive(Debug, Clone)]
pub struct ServiceConfig {
    /// Address to listen on; port 0 selects a free port.
    pub listen: SocketAddr,
    /// Certificate and key; without them the service speaks plain HTTP.
    pub tls: Option<TlsFiles>,
    /// Accept requests without a token on any address.
    pub insecure_no_tokens: bool,
    /// Additional host names of the service when it listens on this machine only, requires no token and is
    /// behind a reverse proxy.
    pub host_names: Vec<String>,
    /// The data folder.
    pub data_dir: PathBuf,
    /// The store, if it is not in the data folder.
    pub store: Option<StoreSettings>,
    /// Folder of recordings that can be replayed; default `recordings` in the data folder.
    pub replay_dir: Option<PathBuf>,
    /// Limits on requests.
    pub http: HttpLimits,
    /// Limits on work.
    pub work: WorkLimits,
    /// Recipients of alarm notifications.
    pub recipients: Recipients,
    /// Settings for simulating libraries, with depths for module 6 mm, which scale with a pair's module.
    pub grid: GridSettings,
}

impl ServiceConfig {
    /// The defaults for a data folder.
    pub fn new(listen: SocketAddr, data_dir: impl Into<PathBuf>) -> Self {
        Self {
            listen,
            tls: None,
            insecure_no_tokens: false,
            host_names: Vec::new(),
            data_dir: data_dir.into(),
            store: None,
            replay_dir: None,
            http: HttpLimits::default(),
            work: WorkLimits::default(),
            recipients: Recipients::default(),
            grid: GridSettings::default(),
        }
    }
}

/// A running service.
pub struct RunningService {
    address: SocketAddr,
    service: Arc<Service>,
    grace: std::time::Duration,
    stop: oneshot::Sender<()>,
    is_tls: bool,
    events: Arc<EventRing>,
    changes: Arc<RwLock<()>>,
    server: JoinHandle<()>,
}

/// Connects a service with others on the same store.
pub struct Node {
    /// The store.
    pub store: Store,
    /// The queue for records.
    pub queue: Arc<dyn WorkQueue>,
    /// Events of all nodes.
    pub events: SharedEvents,
}

/// Starts the service; it runs until [`RunningService::stop`].
/// Fails if the data folder is not writable, in use or of a later version, or if the address is taken.
pub async fn start(config: ServiceConfig, clock: Arc<dyn Clock>) -> Result<RunningService, StartError> {
    start_as(config, None, clock).await
}

/// Starts the service on an opened store of its data folder; it runs until [`RunningService::stop`].
///
/// Fails as [`start`] does.
pub async fn start_on(
    config: ServiceConfig,
    store: Store,
    clock: Arc<dyn Clock>,
) -> Result<RunningService, StartError> {
    start_as(config, Some(Opened::Store(store)), clock).await
}

/// Starts one of several services on the same store. Its data folder holds only replaceable data.
///
/// Fails as [`start`] does.
pub async fn start_node(
    config: ServiceConfig,
    node: Node,
    clock: Arc<dyn Clock>,
) -> Result<RunningService, StartError> {
    start_as(config, Some(Opened::Node(node)), clock).await
}

/// What is open before the start.
enum Opened {
    Store(Store),
    Node(Node),
}

async fn start_as(
    config: ServiceConfig,
    opened: Option<Opened>,
    clock: Arc<dyn Clock>,
) -> Result<RunningService, StartError> {
    if config.http.record_bytes > config.work.bytes_at_once {
        let expected = format!("at most limits.bytes_at_once, {}", config.work.bytes_at_once);
        return Err(SettingError::new("limits.record_bytes", config.http.record_bytes, expected).into());
    }
    let tokens = match &opened {
        None | Some(Opened::Store(_)) => Tokens::of(&config.data_dir),
        Some(Opened::Node(node)) => Tokens::shared(node.store.clone()),
    };
    let is_loopback = config.listen.ip().to_canonical().is_loopback();
    let has_tokens = tokens.list().await?.is_some_and(|tokens| !tokens.is_empty());
    if !is_loopback && !has_tokens && !config.insecure_no_tokens {
        return Err(StartError::NoTokens(config.listen));
    }
    let tls = config.tls.as_ref().map(TlsFiles::load).transpose()?;
    let (store, role, shared) = match opened {
        Some(Opened::Node(Node { store, queue, events })) => (store, Role::ApiNode(queue), Some(events)),
        Some(Opened::Store(store)) => (store, Role::Standalone, None),
        None => {
            let settings = config.store.clone().unwrap_or_else(|| config.data_dir.as_path().into());
            let opened = Store::open(&settings).await;
            let store =
                opened.map_err(|source| StartError::DataDir { path: config.data_dir.clone(), source })?;
            (store, Role::Standalone, None)
        }
    };
    store.notify(config.recipients);
    let listener = TcpListener::bind(config.listen).await;
    let listen_error = |source| StartError::Listen { address: config.listen, source };
    let listener = listener.map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    let mut folders = ServiceFolders::in_data_folder(&config.data_dir);
    if let Some(recordings) = config.replay_dir {
        folders.recordings = recordings;
    }
    let uploads = folders.uploads.clone();
    let service = Service::new(store, folders, &config.work, config.grid, Arc::clone(&clock), role)?;
    let events = match shared {
        Some(shared) => {
            let (history, streams) = (Arc::clone(&service.history), Arc::clone(&service.streams));
            EventRing::share(shared, history, streams, config.http.events_kept)
        }
        None => {
            let run = format!("{:x}", clock.now().as_nanosecond());
            EventRing::start(service.events.subscribe(), run, config.http.events_kept)
        }
    };
    service.resume().await?;
    let grace = config.http.grace;
    let policy = if config.insecure_no_tokens {
        AuthPolicy::Disabled
    } else if is_loopback {
        AuthPolicy::WhenConfigured { host_names: config.host_names }
    } else {
        AuthPolicy::Required
    };
    let access = Access::new(tokens, policy, config.http.requests_per_s);
    let limits = Arc::new(config.http);
    let app = App {
        service: service.clone(),
        limits: Arc::clone(&limits),
        events: Arc::clone(&events),
        access: Arc::new(access),
        upload_waits: Arc::default(),
        measurements: Arc::new(Measurements::default()),
        uploads: uploads.into(),
        lines: Arc::default(),
        previews: Arc::default(),
        event_stream_limiter: ClientLimiter::new(limits.connections / 2, limits.connections / 4),
        write_probe: Arc::default(),
        queue_watch: Arc::default(),
        changes: Arc::default(),
    };
    let changes = Arc::clone(&app.changes);
    resumable::start(&app).await?;
    let (stop, stopped) = oneshot::channel();
    let is_tls = tls.is_some();
    let server = connections::serve(listener, router(app), tls, limits, stopped);
    Ok(RunningService {
        address,
        service,
        grace,
        stop,
        is_tls,
        events,
        changes,
        server: tokio::spawn(server),
    })
}

impl RunningService {
    /// The address it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The address as a URL.
    pub fn url(&self) -> String {
        let scheme = if self.is_tls { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// The parts of the service, for code in the same process.
    pub fn service(&self) -> &Arc<Service> {
        &self.service
    }

    /// Stops accepting requests, finishes running work within the grace period, and closes the store within 2
    /// s more.
    pub async fn stop(self) -> Result<(), StartError> {
        let _ = self.stop.send(());
        self.events.end();
        self.service.streams.stop();
        let mut server = self.server;
        let end = async {
            self.service.replays.stop_all().await;
            let ended = (&mut server).await;
            // Work that continues after its client has disconnected
            let _no_further_change = self.changes.write().await;
            while self.service.workers.queue().0 > 0 {
                tokio::time::sleep(std::time::Duration::from_millis(5)).await;
            }
            ended
        };
        let ended = tokio::time::timeout(self.grace, end).await;
        let ended = match ended {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(StartError::Stopped(error.to_string())),
            Err(_) => {
                tracing::warn!("failed to finish all requests within the grace period");
                server.abort();
                Ok(())
            }
        };
        self.service.streams.close().await;
        // A connection with a long-running statement is not awaited: the database recovers at the next start.
        if tokio::time::timeout(CLOSING, self.service.store.close()).await.is_err() {
            tracing::warn!("failed to close the database in time");
        }
        ended
    }
}
