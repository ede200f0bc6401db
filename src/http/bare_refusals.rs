//! Refusals of hyper's own, with a body: a head that is too large or cannot be read never reaches the router, and hyper answers it bare.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use axum::http::StatusCode;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Sleep;

use super::problem::Problem;

/// How long a refused client's rest is read.
const LINGER: Duration = Duration::from_secs(1);

/// A connection on which refusals without a body are written as problems.
pub(super) struct WithProblems<S> {
    stream: S,
    header_bytes: usize,
    /// A refusal that is being written, and how much of it is.
    refusal: Option<(Vec<u8>, usize)>,
    /// After a refusal: until when what the client still sends is read, so that it gets its answer before the connection is reset.
    lingering: Option<Pin<Box<Sleep>>>,
}

impl<S> WithProblems<S> {
    /// `header_bytes` is what a head may have.
    pub(super) fn new(stream: S, header_bytes: usize) -> Self {
        Self {
            stream,
            header_bytes,
            refusal: None,
            lingering: None,
        }
    }

    /// What is to be written in place of the head of an answer; none where it stays.
    fn instead_of(&self, head: &[u8]) -> Option<Vec<u8>> {
        let status = match head.get(..13)? {
            b"HTTP/1.1 400 " => StatusCode::BAD_REQUEST,
            b"HTTP/1.1 414 " => StatusCode::URI_TOO_LONG,
            b"HTTP/1.1 431 " => StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE,
            _ => return None,
        };
        // The service's own problems have a body.
        let is_bare = head.to_ascii_lowercase().windows(19).any(|part| part == b"content-length: 0\r\n");
        if !is_bare || !head.ends_with(b"\r\n\r\n") {
            return None;
        }
        let detail = match status {
            StatusCode::BAD_REQUEST => "the head of the request is not HTTP/1.1".to_owned(),
            StatusCode::URI_TOO_LONG => format!("the address is too long, expected less than {} bytes", u16::MAX),
            _ => format!(
                "the head of the request is too large, expected at most {} bytes and 100 fields",
                self.header_bytes
            ),
        };
        let body = Problem::new(status, detail).body();
        let reason = status.canonical_reason().unwrap_or_default();
        let mut answer = format!(
            "HTTP/1.1 {} {reason}\r\ncontent-type: application/problem+json\r\ncontent-length: {}\r\nconnection: close\r\n\r\n",
            status.as_u16(),
            body.len()
        )
        .into_bytes();
        answer.extend(body);
        Some(answer)
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for WithProblems<S> {
    fn poll_read(mut self: Pin<&mut Self>, context: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> AsyncWrite for WithProblems<S> {
    fn poll_write(self: Pin<&mut Self>, context: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let this = self.get_mut();
        if this.refusal.is_none() {
            this.refusal = this.instead_of(bytes).map(|refusal| (refusal, 0));
        }
        while let Some((refusal, written)) = &mut this.refusal {
            let more = ready!(Pin::new(&mut this.stream).poll_write(context, &refusal[*written..]))?;
            if more == 0 {
                return Poll::Ready(Err(io::ErrorKind::WriteZero.into()));
            }
            *written += more;
            if *written == refusal.len() {
                this.refusal = None;
                this.lingering = Some(Box::pin(tokio::time::sleep(LINGER)));
                return Poll::Ready(Ok(bytes.len()));
            }
        }
        Pin::new(&mut this.stream).poll_write(context, bytes)
    }

    fn poll_write_vectored(self: Pin<&mut Self>, context: &mut Context<'_>, pieces: &[io::IoSlice<'_>]) -> Poll<io::Result<usize>> {
        let first = pieces.iter().find(|piece| !piece.is_empty());
        match first {
            Some(first) if self.refusal.is_some() || self.instead_of(first).is_some() => self.poll_write(context, first),
            _ => Pin::new(&mut self.get_mut().stream).poll_write_vectored(context, pieces),
        }
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        ready!(Pin::new(&mut this.stream).poll_shutdown(context))?;
        let Some(lingering) = &mut this.lingering else {
            return Poll::Ready(Ok(()));
        };
        let mut ignored = [0; 4096];
        while lingering.as_mut().poll(context).is_pending() {
            let mut buffer = ReadBuf::new(&mut ignored);
            let read = ready!(Pin::new(&mut this.stream).poll_read(context, &mut buffer));
            if read.is_err() || buffer.filled().is_empty() {
                break;
            }
        }
        Poll::Ready(Ok(()))
    }
}
