//! One browser's WebSocket.

use std::sync::Arc;
use std::time::Duration;

use futures_util::{SinkExt as _, StreamExt as _};
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio::sync::mpsc;
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::protocol::{CloseFrame, Role as SocketRole, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Bytes, Message, Utf8Bytes};

use super::run::{Happening, Shared, Way};
use crate::limits::MAX_MESSAGE_BYTES;
use crate::{BrowserId, Input, Role};

/// How long a browser has to take a turn from its socket before it counts as gone: a link on which that takes longer
/// shows nothing of use.
const WRITE_WITHIN: Duration = Duration::from_secs(60);

/// How long the last words to a browser may take.
const CLOSE_WITHIN: Duration = Duration::from_secs(2);

/// What goes to a browser.
#[derive(Debug)]
pub(super) enum ToBrowser {
    /// A text.
    Text(Arc<str>),
    /// A frame.
    Frame(Arc<[u8]>),
    /// The end, for this reason.
    Close(&'static str),
}

/// Carries messages between a browser and the loop until one of them ends it. The loop ends it with the session.
pub(super) async fn serve(
    upgraded: Upgraded,
    id: BrowserId,
    role: Role,
    session: Option<String>,
    shared: Arc<Shared>,
) {
    let config = WebSocketConfig::default()
        .max_message_size(Some(MAX_MESSAGE_BYTES))
        .max_frame_size(Some(MAX_MESSAGE_BYTES))
        .read_buffer_size(MAX_MESSAGE_BYTES);
    let io = TokioIo::new(upgraded);
    let socket = WebSocketStream::from_raw_socket(io, SocketRole::Server, Some(config)).await;
    let (mut sink, mut stream) = socket.split();
    // What waits here is bounded by the core: a browser gets one turn, and nothing more until it has drawn it.
    let (sender, mut outbox) = mpsc::unbounded_channel();
    let way = Way { session, outbox: sender };
    if shared.happenings.send(Happening::Opened(id, role, way)).await.is_err() {
        return;
    }
    let reading = async {
        while let Some(Ok(message)) = stream.next().await {
            let text = match message {
                Message::Text(text) => text.as_str().to_owned(),
                Message::Close(_) | Message::Binary(_) => return,
                _ => continue,
            };
            let input = Happening::Core(Input::Text(id, text));
            if shared.happenings.send(input).await.is_err() {
                return;
            }
        }
    };
    let writing = async {
        while let Some(what) = outbox.recv().await {
            let message = match what {
                ToBrowser::Text(text) => Message::Text(Utf8Bytes::from(&*text)),
                ToBrowser::Frame(frame) => Message::Binary(Bytes::from_owner(frame)),
                ToBrowser::Close(reason) => {
                    let frame = CloseFrame { code: CloseCode::Policy, reason: reason.into() };
                    let last = sink.send(Message::Close(Some(frame)));
                    let _ = tokio::time::timeout(CLOSE_WITHIN, last).await;
                    return;
                }
            };
            match tokio::time::timeout(WRITE_WITHIN, sink.send(message)).await {
                Ok(Ok(())) => {}
                _ => return,
            }
        }
    };
    tokio::select! {
        () = reading => {}
        () = writing => {}
    }
    // The loop ends with the process, and then no one needs to know.
    let _ = shared.happenings.send(Happening::Core(Input::Closed(id))).await;
}
