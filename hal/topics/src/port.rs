//! Topics of plain messages: one writer, the newest values win.

use core::fmt::Debug;
use core::marker::PhantomData;
use std::sync::Arc;

use iceoryx2::port::publisher::Publisher as RawPublisher;
use iceoryx2::port::subscriber::Subscriber as RawSubscriber;
use iceoryx2::port::update_connections::UpdateConnections as _;
use iceoryx2::prelude::ZeroCopySend;

use super::events::Bell;
use super::limits::{LOANED_MAX, Service, UNREAD};
use super::{TopicError, TopicNode};
use hal::Chunk;

/// A message that can lie in shared memory as it is: `repr(C)`, no pointers, every bit pattern a
/// value.
pub trait Message: Copy + Debug + ZeroCopySend + 'static {
    /// Last part of the topic's name.
    const TOPIC: &'static str;

    /// Unread messages that a reader keeps: with 1, which most have, only the newest.
    const UNREAD: usize = UNREAD;
}

impl Message for Chunk {
    const TOPIC: &'static str = "chunk";
}

/// A topic that carries `M`; only its constructors are of interest.
#[derive(Debug)]
pub struct Topic<M>(PhantomData<M>);

impl<M: Message> Topic<M> {
    /// The only writer of the topic of `arm` (`psm1`).
    ///
    /// # Errors
    /// [`TopicError`]; in particular [`TopicError::AlreadyPublished`] while another writer is
    /// alive.
    pub fn publisher(node: &TopicNode, arm: &str) -> Result<Publisher<M>, TopicError> {
        let topic = node.service_name(&format!("{arm}/{}", M::TOPIC))?;
        let service = node.open::<M, ()>(&topic, M::UNREAD)?;
        let create = || {
            service
                .publisher_builder()
                .max_loaned_samples(LOANED_MAX)
                .create()
        };
        let raw = node.create_publisher(&topic, (size_of::<M>(), M::UNREAD), create)?;
        let bell = node.bell();
        Ok(Publisher { raw, topic, bell })
    }

    /// A reader of the topic of `arm`; it may come before the writer.
    ///
    /// # Errors
    /// [`TopicError`].
    pub fn subscriber(node: &TopicNode, arm: &str) -> Result<Subscriber<M>, TopicError> {
        let topic = node.service_name(&format!("{arm}/{}", M::TOPIC))?;
        let service = node.open::<M, ()>(&topic, M::UNREAD)?;
        let raw = node.create_subscriber(&topic, || service.subscriber_builder().create())?;
        Ok(Subscriber { raw, topic })
    }
}

/// Writes the messages of one topic.
#[derive(Debug)]
pub struct Publisher<M: Message> {
    raw: RawPublisher<Service, M, ()>,
    topic: String,
    bell: Arc<Bell>,
}

impl<M: Message> Publisher<M> {
    /// Publishes `message` and wakes who waits; never waits for readers. The number of readers that
    /// it reached.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn publish(&self, message: &M) -> Result<usize, TopicError> {
        let reached = self.raw.send_copy(*message);
        let reached =
            reached.map_err(|error| TopicError::transport(&self.topic, "publishing", &error))?;
        self.bell.ring();
        Ok(reached)
    }

    /// Hands the newest message to readers that have come since; call it now and then when there is
    /// nothing to say.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn keep_alive(&self) -> Result<(), TopicError> {
        self.raw
            .update_connections()
            .map_err(|error| TopicError::transport(&self.topic, "connecting", &error))
    }
}

/// Reads the messages of one topic.
#[derive(Debug)]
pub struct Subscriber<M: Message> {
    raw: RawSubscriber<Service, M, ()>,
    topic: String,
}

impl<M: Message> Subscriber<M> {
    /// The newest message, if one has come since the last call.
    ///
    /// Bits are handed over as they were written, nonsense included.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn newest(&self) -> Result<Option<M>, TopicError> {
        let mut newest = None;
        while let Some(message) = self.next_unread()? {
            newest = Some(message);
        }
        Ok(newest)
    }

    /// The oldest of the unread messages, of which there are [`Message::UNREAD`] at most.
    ///
    /// Bits are handed over as they were written, nonsense included.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn next_unread(&self) -> Result<Option<M>, TopicError> {
        let sample = self.raw.receive();
        let sample =
            sample.map_err(|error| TopicError::transport(&self.topic, "receiving", &error))?;
        Ok(sample.map(|sample| *sample))
    }
}
