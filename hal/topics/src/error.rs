//! What can go wrong on a topic.

/// Why a topic could not be opened, written or read.
#[derive(Debug, thiserror::Error)]
pub enum TopicError {
    /// The run id or a topic name cannot be part of a service name.
    #[error(
        "'{name}' cannot name a topic: use 1 to {max} letters, digits, '-' and '_', in parts joined by '/'"
    )]
    BadName {
        /// The name.
        name: String,
        /// Most characters allowed.
        max: usize,
    },
    /// Shared memory has no room for the topic's buffers.
    #[error(
        "topic '{topic}' needs {needed_bytes} bytes of shared memory, {dir} has {free_bytes} of {total_bytes} free; \
         make it larger (containers: --shm-size=512m) or remove stale files there"
    )]
    SharedMemoryTooSmall {
        /// The topic.
        topic: String,
        /// The shared memory file system.
        dir: &'static str,
        /// What the topic's buffers take.
        needed_bytes: u64,
        /// What is left.
        free_bytes: u64,
        /// Size of the file system.
        total_bytes: u64,
    },
    /// The transport's own folder can't be written.
    #[error(
        "{dir}: cannot be written, where iceoryx2 keeps what the processes of a run share: {source}; it may belong to another user"
    )]
    Folder {
        /// The folder.
        dir: std::path::PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A live publisher already has this topic.
    #[error("topic '{topic}' already has a publisher in another process or thread of this run")]
    AlreadyPublished {
        /// The topic.
        topic: String,
    },
    /// As many readers as the topic can have.
    #[error("topic '{topic}' already has its {max} subscribers")]
    TooManySubscribers {
        /// The topic.
        topic: String,
        /// How many it can have.
        max: usize,
    },
    /// The other side was built with another layout of the message.
    #[error(
        "topic '{topic}' carries another type or layout of messages; both processes must be of the same version"
    )]
    OtherType {
        /// The topic.
        topic: String,
    },
    /// An image larger than the topic was opened for.
    #[error("topic '{topic}' holds frames of up to {capacity} pixels, this one has {pixels}")]
    FrameTooLarge {
        /// The topic.
        topic: String,
        /// Most pixels a frame can have.
        capacity: usize,
        /// Pixels of the frame.
        pixels: usize,
    },
    /// The size in a received frame's header does not match its data.
    #[error("topic '{topic}': a frame of {width}x{height} pixels came with {words} words of data")]
    FrameShape {
        /// The topic.
        topic: String,
        /// Width in the header, pixels.
        width: u32,
        /// Height in the header, pixels.
        height: u32,
        /// Length of the data, 32-bit words.
        words: usize,
    },
    /// More frames are being looked at, or filled, than the topic has buffers for.
    #[error("topic '{topic}': too many frames are held at once; drop one first")]
    TooManyHeld {
        /// The topic.
        topic: String,
    },
    /// The transport failed.
    #[error("topic '{topic}': {action} failed: {reason}")]
    Transport {
        /// The topic, or the run for the node itself.
        topic: String,
        /// What was tried.
        action: &'static str,
        /// The transport's reason.
        reason: String,
    },
}

impl TopicError {
    pub(super) fn transport(
        topic: &str,
        action: &'static str,
        reason: &impl std::fmt::Display,
    ) -> Self {
        Self::Transport {
            topic: topic.to_owned(),
            action,
            reason: reason.to_string(),
        }
    }
}
