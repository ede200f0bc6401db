//! Connections: limits on number and time, and TLS.

use std::convert::Infallible;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::http::{HeaderValue, Request, StatusCode, header};
use axum::response::{IntoResponse, Response};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::{oneshot, watch};
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{self, ServerConfig};

use super::limits::HttpLimits;
use super::start_error::StartError;
use crate::http::access::client::{Client, ClientLimiter, PeerAddress};
use crate::http::problem::Problem;

/// Maximum number of header fields of a request.
const MAX_HEADERS: usize = 100;

/// Connections beyond the limit, each for one request: health checks are answered, everything else is
/// refused.
const RESERVE: usize = 64;

/// Those of one address.
const RESERVE_OF_ONE: usize = RESERVE / 2;

/// Time to send the request head on a reserve connection.
const RESERVE_TIMEOUT: Duration = Duration::from_secs(1);

/// Delay after the system refused a connection, usually for lack of file descriptors.
const AFTER_REFUSAL: Duration = Duration::from_millis(100);

/// Certificate and key of the service, as PEM files.
#[derive(Debug, Clone)]
pub struct TlsFiles {
    /// The certificate chain.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
}

impl TlsFiles {
    /// Loads both files.
    pub(crate) fn load(&self) -> Result<TlsAcceptor, StartError> {
        let tls = |path: &Path, reason: String| StartError::Tls { path: path.to_path_buf(), reason };
        let certificates: Result<Vec<_>, _> =
            CertificateDer::pem_file_iter(&self.certificate).and_then(Iterator::collect);
        let certificates = certificates.map_err(|error| tls(&self.certificate, error.to_string()))?;
        let key =
            PrivateKeyDer::from_pem_file(&self.key).map_err(|error| tls(&self.key, error.to_string()))?;
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .and_then(|config| config.with_no_client_auth().with_single_cert(certificates, key));
        let mut config = config.map_err(|error| tls(&self.certificate, error.to_string()))?;
        config.alpn_protocols = vec![b"http/1.1".to_vec()];
        Ok(TlsAcceptor::from(Arc::new(config)))
    }
}

/// Accepts connections until told to stop, then waits for running requests.
pub(crate) async fn serve(
    listener: TcpListener,
    router: Router,
    tls: Option<TlsAcceptor>,
    limits: Arc<HttpLimits>,
    mut stop: oneshot::Receiver<()>,
) {
    // A single client leaves a quarter to the others
    let limiter = ClientLimiter::new(limits.connections, limits.connections.saturating_mul(3) / 4);
    // Further connections are closed: one that waited would keep all later ones waiting
    let reserve = ClientLimiter::new(RESERVE, RESERVE_OF_ONE);
    // Every connection holds a receiver until it ends or becomes a WebSocket.
    let is_ending = watch::Sender::new(false);
    loop {
        let accepted = tokio::select! {
            // An error means that the handle was dropped, which also ends the service.
            _ = &mut stop => break,
            accepted = listener.accept() => accepted,
        };
        let (stream, from) = match accepted {
            Ok((stream, from)) => (stream, from.ip().to_canonical()),
            Err(error) => {
                tracing::warn!(%error, "failed to accept a connection");
                tokio::time::sleep(AFTER_REFUSAL).await;
                continue;
            }
        };
        let (router, tls, limits, ending) =
            (router.clone(), tls.clone(), Arc::clone(&limits), is_ending.subscribe());
        let client = Client::Address(Some(from));
        let (permit, is_in_reserve) = match limiter.try_acquire(client.clone()) {
            Some(permit) => (permit, false),
            None => match reserve.try_acquire(client) {
                Some(permit) => (permit, true),
                None => continue,
            },
        };
        let peer = Peer { address: from, is_in_reserve };
        tokio::spawn(async move {
            let _permit = permit;
            let _ = stream.set_nodelay(true);
            let Some(tls) = tls else {
                return serve_connection(stream, router, &limits, peer, ending).await;
            };
            match tokio::time::timeout(peer.header_timeout(&limits), tls.accept(stream)).await {
                Ok(Ok(stream)) => serve_connection(stream, router, &limits, peer, ending).await,
                Ok(Err(error)) => tracing::debug!(%error, "TLS handshake failed"),
                Err(_) => tracing::debug!("TLS handshake timed out"),
            }
        });
    }
    drop(listener);
    is_ending.send_replace(true);
    is_ending.closed().await;
}

/// The peer of a connection.
#[derive(Debug, Clone, Copy)]
struct Peer {
    address: IpAddr,
    /// No slot was free: only one request is served, and only if it is a health check.
    is_in_reserve: bool,
}

impl Peer {
    fn header_timeout(self, limits: &HttpLimits) -> Duration {
        if self.is_in_reserve { limits.header_timeout.min(RESERVE_TIMEOUT) } else { limits.header_timeout }
    }

    /// Why a request is refused on this connection.
    fn refusal(self, path: &str) -> Option<Response> {
        let is_refused = self.is_in_reserve && !matches!(path, "/healthz" | "/readyz");
        is_refused
            .then(|| Problem::busy("too many connections of this client or in total", 1).into_response())
    }
}

/// Makes the connection close after a response.
pub(crate) fn closing(mut response: Response) -> Response {
    response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    response
}

/// Serves the requests of one connection.
async fn serve_connection(
    stream: impl AsyncRead + AsyncWrite + Send + 'static,
    router: Router,
    limits: &HttpLimits,
    peer: Peer,
    mut ending: watch::Receiver<bool>,
) {
    // A client that does not read the response loses its slot
    let mut stream = TimeoutStream::new(stream);
    stream.set_write_timeout(Some(limits.write_timeout));
    let router = TowerToHyperService::new(router);
    let respond = move |mut request: Request<Incoming>| {
        let refusal = peer.refusal(request.uri().path());
        request.extensions_mut().insert(PeerAddress(peer.address));
        let routed = refusal.is_none().then(|| router.call(request));
        async move {
            let response = match (refusal, routed) {
                (Some(refusal), _) => refusal,
                (None, Some(routed)) => routed.await?,
                (None, None) => StatusCode::SERVICE_UNAVAILABLE.into_response(),
            };
            Ok::<_, Infallible>(if peer.is_in_reserve { closing(response) } else { response })
        }
    };
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(peer.header_timeout(limits))
        .max_buf_size(limits.header_bytes)
        .max_headers(MAX_HEADERS)
        .serve_connection(TokioIo::new(Box::pin(stream)), service_fn(respond))
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    let ended = tokio::select! {
        ended = &mut connection => ended,
        // Finishes the running request and accepts no other
        () = async { drop(ending.wait_for(|is_ending| *is_ending).await) } => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::debug!(%error, "connection ended");
    }
}
