//! Connections: so many at a time, so that whoever opens thousands takes no file descriptor from
//! the run; each has to speak within seconds, and in TLS where other machines reach it.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::{Extension, Router};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::io::{AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{sleep, timeout};
use tokio_rustls::server::TlsStream;

use super::seats::PAGES_MAX;
use super::tls::Tls;

/// Connections at a time: every page keeps one, and takes several while it loads.
const CONNECTIONS_MAX: usize = 2 * PAGES_MAX;

/// Time from the connection to the end of the TLS handshake.
const HANDSHAKE: Duration = Duration::from_secs(5);

/// Time for the head of a request, from the end of the one before.
const HEAD: Duration = Duration::from_secs(20);

/// Bytes of a request's head, and of what waits to leave.
const BUFFER_BYTES_MAX: usize = 32 << 10;

/// Time until file descriptors are there again, if there were none.
const RETRY: Duration = Duration::from_millis(200);

/// The first byte of a TLS handshake.
const TLS_HANDSHAKE: u8 = 0x16;

/// What whoever speaks plain HTTP to TLS is told.
const PLAINTEXT: &[u8] = b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\nConnection: close\r\n\r\nrefused: this port speaks TLS alone: open the https address that trocar has printed\n";

/// The permit of a connection, one of a bounded number; released when its last copy is dropped.
#[derive(Clone)]
pub(super) struct ConnectionPermit(Arc<OwnedSemaphorePermit>);

impl ConnectionPermit {
    /// Gives it up.
    pub(super) fn leave(self) {
        drop(self.0);
    }
}

/// Serves `router` to whoever comes; what is too much is closed as soon as it is accepted.
pub(super) async fn admit(listener: TcpListener, tls: Option<Tls>, router: Router) -> Infallible {
    let free = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    loop {
        let Ok((stream, _)) = listener.accept().await else {
            sleep(RETRY).await;
            continue;
        };
        if let Ok(place) = Arc::clone(&free).try_acquire_owned() {
            let place = ConnectionPermit(Arc::new(place));
            tokio::spawn(attend(stream, tls.clone(), router.clone(), place));
        }
    }
}

/// One connection, from its handshake to its end. Failures are the client's and end here.
async fn attend(stream: TcpStream, tls: Option<Tls>, router: Router, place: ConnectionPermit) {
    let _late = stream.set_nodelay(true);
    let Some(tls) = tls else {
        return talk(stream, router, place).await;
    };
    if let Ok(Some(stream)) = timeout(HANDSHAKE, secure(stream, &tls)).await {
        talk(stream, router, place).await;
    }
}

/// The connection in TLS; none if it fails, or begins in another way.
async fn secure(mut stream: TcpStream, tls: &Tls) -> Option<TlsStream<TcpStream>> {
    let mut first = [0];
    let count = stream.peek(&mut first).await.ok()?;
    if count > 0 && first != [TLS_HANDSHAKE] {
        // What is not read when a connection closes resets it, and the answer with it.
        let mut asked = [0; 4096];
        let _count = stream.read(&mut asked).await.ok()?;
        stream.write_all(PLAINTEXT).await.ok()?;
        stream.shutdown().await.ok()?;
        return None;
    }
    tls.acceptor().accept(stream).await.ok()
}

/// HTTP/1.1 on `stream`, until it ends or becomes a WebSocket.
async fn talk<S>(stream: S, router: Router, place: ConnectionPermit)
where
    S: AsyncRead + AsyncWrite + Send + Unpin + 'static,
{
    let router = router.layer(Extension(place));
    let served = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(HEAD)
        .max_buf_size(BUFFER_BYTES_MAX)
        .serve_connection(TokioIo::new(stream), TowerToHyperService::new(router))
        .with_upgrades();
    // Whoever goes in the middle of a request wants no answer.
    let _gone = served.await;
}
