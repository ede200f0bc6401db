//! The service as a whole: its parts put together, started and stopped.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::access::{Access, Asked, TokenPlace};
use super::connections::{self, TlsFiles};
use super::events::{Events, SharedEvents};
use super::limits::HttpLimits;
use super::metrics::Measurements;
use super::resumable::ResumableUploads;
use super::router::{App, router};
use super::shared_tokens::SharedTokens;
use super::tokens::{TokenError, Tokens};
use crate::ingest::{Clock, Crew, Ingest, IngestError, IngestFolders, IngestLimits, Part};
use crate::library::GridSettings;
use crate::store::{Store, StoreError, StoreSettings};

/// How long the database may take to close after everything else has ended.
const CLOSING: std::time::Duration = std::time::Duration::from_secs(2);

/// What the service is started with.
#[derive(Debug, Clone)]
pub struct ServiceConfig {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// Certificate and key; without them the service speaks plain HTTP.
    pub tls: Option<TlsFiles>,
    /// Nobody is asked for a token, on whatever address.
    pub insecure_no_tokens: bool,
    /// Names by which others know the service, where it listens on this machine alone, asks nobody for a token and another server passes on
    /// what is for it.
    pub host_names: Vec<String>,
    /// Where everything is kept.
    pub data_dir: PathBuf,
    /// The store, where it is not in the data folder.
    pub store: Option<StoreSettings>,
    /// Recordings that may be replayed; `recordings` in the data folder where not given.
    pub replay_dir: Option<PathBuf>,
    /// Limits on requests.
    pub http: HttpLimits,
    /// Limits on work.
    pub ingest: IngestLimits,
    /// How libraries are simulated.
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
            ingest: IngestLimits::default(),
            grid: GridSettings::default(),
        }
    }
}

/// Why the service does not run.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// The data folder, or the store that it points to, cannot be used.
    #[error("cannot use the data folder {path}: {source}", path = path.display())]
    DataDir {
        /// The folder.
        path: PathBuf,
        /// Why not.
        source: StoreError,
    },
    /// A part could not be started.
    #[error(transparent)]
    Ingest(#[from] IngestError),
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}{hint}", hint = if source.kind() == std::io::ErrorKind::AddrInUse { "; is another flankwatch running? --listen takes another address" } else { "" })]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// Everyone could do everything from elsewhere.
    #[error(
        "listening on {0} needs tokens, and there are none: make one with `flankwatch token create`, listen on 127.0.0.1, or say \
         --insecure-no-tokens where everyone who reaches the address may do everything"
    )]
    NoTokens(SocketAddr),
    /// The tokens cannot be read.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// Certificate or key cannot be used.
    #[error("cannot use {path} for TLS: {reason}", path = path.display())]
    Tls {
        /// The file.
        path: PathBuf,
        /// Why not.
        reason: String,
    },
    /// A setting does not go with another.
    #[error("{field} is {value}, expected {expected}")]
    Setting {
        /// Which setting.
        field: &'static str,
        /// Its value.
        value: String,
        /// What would have been right.
        expected: String,
    },
    /// The server ended by itself.
    #[error("the server stopped: {0}")]
    Stopped(String),
}

/// A running service.
pub struct RunningService {
    address: SocketAddr,
    ingest: Ingest,
    grace: std::time::Duration,
    stop: oneshot::Sender<()>,
    is_tls: bool,
    events: Arc<Events>,
    server: JoinHandle<()>,
}

/// What joins a service with others on the same store.
pub struct Node {
    /// The store.
    pub store: Store,
    /// Who the records are handed over to.
    pub crew: Arc<dyn Crew>,
    /// What all nodes show.
    pub events: SharedEvents,
}

/// Starts the service; it runs until [`RunningService::stop`].
///
/// Errors: the data folder is not writable, in use or of a later version; the address is taken.
pub async fn start(config: ServiceConfig, clock: Arc<dyn Clock>) -> Result<RunningService, ServiceError> {
    start_as(config, None, clock).await
}

/// Starts one of several services on the same store. Its data folder holds nothing that is not somewhere else too.
///
/// Errors: as those of [`start`].
pub async fn start_node(config: ServiceConfig, node: Node, clock: Arc<dyn Clock>) -> Result<RunningService, ServiceError> {
    start_as(config, Some(node), clock).await
}

async fn start_as(config: ServiceConfig, node: Option<Node>, clock: Arc<dyn Clock>) -> Result<RunningService, ServiceError> {
    if config.http.record_bytes > config.ingest.bytes_at_once {
        return Err(ServiceError::Setting {
            field: "limits.record_bytes",
            value: config.http.record_bytes.to_string(),
            expected: format!("at most limits.bytes_at_once, {}", config.ingest.bytes_at_once),
        });
    }
    let tokens = match &node {
        None => TokenPlace::File(Tokens::of(&config.data_dir)),
        Some(node) => {
            let tokens = SharedTokens::of(node.store.clone());
            tokens.take_over(&config.data_dir).await?;
            TokenPlace::Shared(tokens)
        }
    };
    let is_loopback = config.listen.ip().to_canonical().is_loopback();
    let has_tokens = tokens.list().await?.is_some_and(|tokens| !tokens.is_empty());
    if !is_loopback && !has_tokens && !config.insecure_no_tokens {
        return Err(ServiceError::NoTokens(config.listen));
    }
    let tls = config.tls.as_ref().map(TlsFiles::load).transpose()?;
    let (store, part, shared) = match node {
        Some(Node { store, crew, events }) => (store, Part::Entrance(crew), Some(events)),
        None => {
            let settings = config.store.clone().unwrap_or_else(|| config.data_dir.as_path().into());
            let opened = Store::open(&settings).await;
            let store = opened.map_err(|source| ServiceError::DataDir {
                path: config.data_dir.clone(),
                source,
            })?;
            (store, Part::Whole, None)
        }
    };
    let listener = TcpListener::bind(config.listen).await;
    let listen_error = |source| ServiceError::Listen {
        address: config.listen,
        source,
    };
    let listener = listener.map_err(listen_error)?;
    let address = listener.local_addr().map_err(listen_error)?;
    let folders = IngestFolders {
        libraries: config.data_dir.join("libraries"),
        recordings: config.replay_dir.unwrap_or_else(|| config.data_dir.join("recordings")),
        uploads: config.data_dir.join("uploads"),
    };
    let uploads = folders.uploads.clone();
    let ingest = Ingest::with_part(store, folders, &config.ingest, config.grid, Arc::clone(&clock), part)?;
    let events = match shared {
        Some(shared) => Events::share(shared, ingest.clone(), config.http.events_kept),
        None => {
            let run = format!("{:x}", clock.now().as_nanosecond());
            Events::follow(ingest.follow(), run, config.http.events_kept)
        }
    };
    ingest.resume().await?;
    let grace = config.http.grace;
    let resumable = if ingest.store().is_shared() {
        ResumableUploads::shared(config.http.recording_bytes)
    } else {
        let folder = config.data_dir.join("resumable");
        let opened = ResumableUploads::open(folder.clone(), config.http.recording_bytes, clock.now());
        opened.map_err(|source| IngestError::File {
            action: "read",
            path: folder,
            source,
        })?
    };
    let who = if config.insecure_no_tokens {
        Asked::Nobody
    } else if is_loopback {
        Asked::OnceThereAreTokens {
            host_names: config.host_names,
        }
    } else {
        Asked::Everybody
    };
    let access = Access::new(tokens, who, config.http.requests_per_s);
    let limits = Arc::new(config.http);
    let app = App {
        ingest: ingest.clone(),
        limits: Arc::clone(&limits),
        events: Arc::clone(&events),
        access: Arc::new(access),
        resumable: Arc::new(resumable),
        measurements: Arc::new(Measurements::default()),
        uploads: uploads.into(),
        lines: Arc::default(),
    };
    ResumableUploads::watch(&app);
    let (stop, stopped) = oneshot::channel();
    let is_tls = tls.is_some();
    let server = connections::serve(listener, router(app), tls, limits, stopped);
    Ok(RunningService {
        address,
        ingest,
        grace,
        stop,
        is_tls,
        events,
        server: tokio::spawn(server),
    })
}

impl RunningService {
    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The address as a URL.
    pub fn url(&self) -> String {
        let scheme = if self.is_tls { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }

    /// The path of records through the service, for records from inside the process.
    pub fn ingest(&self) -> &Ingest {
        &self.ingest
    }

    /// Stops taking requests, ends within the time of grace what was begun, and closes the store within 2 s more.
    pub async fn stop(self) -> Result<(), ServiceError> {
        let _ = self.stop.send(());
        self.events.end();
        let mut server = self.server;
        let end = async {
            self.ingest.stop_replays().await;
            let ended = (&mut server).await;
            // What goes on by itself after its client has gone.
            while self.ingest.workers().queue().0 > 0 {
                tokio::time::sleep(std::time::Duration::from_millis(5)).await;
            }
            ended
        };
        let ended = tokio::time::timeout(self.grace, end).await;
        let ended = match ended {
            Ok(Ok(())) => Ok(()),
            Ok(Err(error)) => Err(ServiceError::Stopped(error.to_string())),
            Err(_) => {
                tracing::warn!("requests were still under way at the end of the time of grace");
                server.abort();
                Ok(())
            }
        };
        // A connection that works on something long is not waited for: the database repairs itself at the next start.
        if tokio::time::timeout(CLOSING, self.ingest.store().close()).await.is_err() {
            tracing::warn!("the database was still at work when the service ended");
        }
        ended
    }
}
