//! A process's membership in a run: names, clean-up after the dead, and how services are opened.

use core::fmt::Debug;
use core::time::Duration;
use std::fs;
use std::path::Path;
use std::sync::Arc;

use iceoryx2::node::NodeState;
use iceoryx2::port::publisher::PublisherCreateError;
use iceoryx2::port::subscriber::SubscriberCreateError;
use iceoryx2::prelude::{
    CallbackProgression, Config, FileName, IceoryxSend, LogLevel, Node, NodeBuilder,
    SemanticString, ServiceName, SignalHandlingMode, ZeroCopySend, set_log_level,
};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError as CreateError, PublishSubscribeOpenError as OpenError,
    PublishSubscribeOpenOrCreateError as ServiceError,
};
use iceoryx2::service::port_factory::publish_subscribe::PortFactory;

use super::events::{Bell, EventService, Events};
use super::limits::{
    HELD_MAX, HISTORY, NODES_MAX, OPEN_TRIES, RETRY_PAUSE, SUBSCRIBERS_MAX, Service, buffers,
};
use super::{SHARED_MEMORY_DIR, SharedMemorySpace, TopicError, shm, unfinished};

const NAME_MAX: usize = 100;
const CLEANUP_TIMEOUT: Duration = Duration::from_secs(1);

/// One process's (or thread's) membership in a run. Topics are opened through it and outlive it if
/// need be.
#[derive(Debug)]
pub struct TopicNode {
    node: Node<Service>,
    events: EventService,
    run_id: String,
}

impl TopicNode {
    /// Joins the run `run_id`; all processes of a run use the same one.
    ///
    /// Removes what processes that died left in shared memory. Installs no signal handlers, and
    /// quietens the transport's own log to errors.
    ///
    /// # Errors
    /// [`TopicError::BadName`], [`TopicError::Transport`].
    pub fn join(run_id: &str) -> Result<Self, TopicError> {
        check_name(run_id, false)?;
        set_log_level(LogLevel::Error);
        let config = transport_config(run_id)?;
        let global = &config.global;
        let folders = [*global.root_path(), global.node_dir(), global.service_dir()];
        let or_folder = |error: TopicError| {
            let mut folders = folders.iter();
            let unwritable = folders.find_map(|dir| unwritable(Path::new(&dir.to_string())));
            unwritable.unwrap_or(error)
        };
        let node = NodeBuilder::new()
            .config(&config)
            .signal_handling_mode(SignalHandlingMode::Disabled)
            .create::<Service>()
            .map_err(|error| or_folder(TopicError::transport(run_id, "joining the run", &error)))?;
        remove_dead(&node);
        Ok(Self {
            events: EventService::open(&node, run_id).map_err(or_folder)?,
            node,
            run_id: run_id.to_owned(),
        })
    }

    /// The run's id.
    #[must_use]
    pub fn run_id(&self) -> &str {
        &self.run_id
    }

    /// A place to wait for what the run's processes publish, for one thread.
    ///
    /// # Errors
    /// [`TopicError::Transport`].
    pub fn events(&self) -> Result<Events, TopicError> {
        self.events.listen()
    }

    /// What a writer wakes others with.
    pub(super) fn bell(&self) -> Arc<Bell> {
        self.events.bell()
    }

    /// Frees what processes that died without cleaning up still hold; the number of them.
    ///
    /// Death is noticed only by looking: a supervisor calls this now and then. Takes milliseconds.
    pub fn remove_dead(&self) -> u64 {
        remove_dead(&self.node)
    }

    /// Frees what `process` still holds, which is about to die or has just died; `false` if it
    /// lives longer than `within`.
    ///
    /// A process that is killed is no longer its children's parent some time before the last of its
    /// threads lets go of its locks, by which the transport knows the living from the dead: one
    /// look at that moment finds no dead node.
    pub fn remove_dying(&self, process: u32, within: Duration) -> bool {
        let tries = within.as_millis() / RETRY_PAUSE.as_millis();
        for _ in 0..=tries {
            self.remove_dead();
            if !self.has_node_of(process) {
                return true;
            }
            if self.node.wait(RETRY_PAUSE).is_err() {
                break;
            }
        }
        false
    }

    /// Whether `process` takes part, alive or dead.
    fn has_node_of(&self, process: u32) -> bool {
        let mut found = false;
        let listed = Node::<Service>::list(self.node.config(), |state| {
            let pid = state.node_id().pid::<Service>();
            found |= pid.is_ok_and(|pid| u32::try_from(pid.value()) == Ok(process));
            CallbackProgression::Continue
        });
        found || listed.is_err()
    }

    /// Whether a node of `process` is alive; also if that can't be told.
    #[must_use]
    pub fn is_alive(&self, process: u64) -> bool {
        let mut alive = false;
        let listed = Node::<Service>::list(self.node.config(), |state| {
            let dead = matches!(state, NodeState::Dead(_));
            let pid = state.node_id().pid::<Service>();
            alive |= !dead && pid.is_ok_and(|pid| u64::try_from(pid.value()) == Ok(process));
            CallbackProgression::Continue
        });
        alive || listed.is_err()
    }

    /// The full service name of `topic`.
    pub(super) fn service_name(&self, topic: &str) -> Result<String, TopicError> {
        check_name(topic, true)?;
        Ok(format!("trocar/{}/{topic}", self.run_id))
    }

    /// Opens or creates the service `name` with the quality of service that all topics share:
    /// readers keep the newest `unread` values.
    pub(super) fn open<P, H>(
        &self,
        name: &str,
        unread: usize,
    ) -> Result<PortFactory<Service, P, H>, TopicError>
    where
        P: IceoryxSend + Debug + ?Sized,
        H: Debug + ZeroCopySend,
        Builder<P, H>: OpenOrCreate<P, H>,
    {
        let service_name = ServiceName::new(name)
            .map_err(|error| TopicError::transport(name, "naming the service", &error))?;
        for _ in 0..OPEN_TRIES {
            let builder = self
                .node
                .service_builder(&service_name)
                .publish_subscribe::<P>()
                .user_header::<H>();
            let error = match newest_win(builder, unread).open_or_create_service() {
                Ok(service) => return Ok(service),
                Err(error) => error,
            };
            if !is_transient(error) {
                return Err(service_error(name, error));
            }
            if let Err(error) = self.node.wait(RETRY_PAUSE) {
                return Err(TopicError::transport(name, "waiting for a peer", &error));
            }
        }
        Err(TopicError::transport(
            name,
            "opening the service",
            &"a peer never finished creating or removing it",
        ))
    }

    /// Makes the single publisher; a dead predecessor is cleared away first if it is in the way.
    pub(super) fn create_publisher<T>(
        &self,
        topic: &str,
        (value_bytes, unread): (usize, usize),
        create: impl Fn() -> Result<T, PublisherCreateError>,
    ) -> Result<T, TopicError> {
        let needed_bytes = u64::try_from(buffers(unread) * value_bytes).unwrap_or(u64::MAX);
        let missing = SharedMemorySpace {
            total_bytes: 0,
            free_bytes: 0,
        };
        let space = shm::shared_memory_space().unwrap_or(missing);
        shm::check_room(topic, needed_bytes, space)?;
        let mut result = create();
        if matches!(
            result,
            Err(PublisherCreateError::ExceedsMaxSupportedPublishers)
        ) {
            self.remove_dead();
            result = create();
        }
        result.map_err(|error| publisher_error(topic, needed_bytes, error))
    }

    /// Makes a subscriber, clearing away dead ones first if they are in the way.
    pub(super) fn create_subscriber<T>(
        &self,
        topic: &str,
        create: impl Fn() -> Result<T, SubscriberCreateError>,
    ) -> Result<T, TopicError> {
        let mut result = create();
        if matches!(
            result,
            Err(SubscriberCreateError::ExceedsMaxSupportedSubscribers)
        ) {
            self.remove_dead();
            result = create();
        }
        result.map_err(|error| {
            if error == SubscriberCreateError::ExceedsMaxSupportedSubscribers {
                return TopicError::TooManySubscribers {
                    topic: topic.to_owned(),
                    max: SUBSCRIBERS_MAX,
                };
            }
            TopicError::transport(topic, "subscribing", &error)
        })
    }
}

/// The transport's builder for payload `P` and header `H`.
pub(super) type Builder<P, H> =
    iceoryx2::service::builder::publish_subscribe::Builder<P, H, Service>;

/// Bridges the transport's two `open_or_create`, for single values and for slices.
pub(super) trait OpenOrCreate<P: IceoryxSend + Debug + ?Sized, H: Debug + ZeroCopySend> {
    fn open_or_create_service(self) -> Result<PortFactory<Service, P, H>, ServiceError>;
}

impl<P: Debug + ZeroCopySend, H: Debug + ZeroCopySend> OpenOrCreate<P, H> for Builder<P, H> {
    fn open_or_create_service(self) -> Result<PortFactory<Service, P, H>, ServiceError> {
        self.open_or_create()
    }
}

impl<P: Debug + ZeroCopySend, H: Debug + ZeroCopySend> OpenOrCreate<[P], H> for Builder<[P], H> {
    fn open_or_create_service(self) -> Result<PortFactory<Service, [P], H>, ServiceError> {
        self.open_or_create()
    }
}

fn newest_win<P, H>(builder: Builder<P, H>, unread: usize) -> Builder<P, H>
where
    P: IceoryxSend + Debug + ?Sized,
    H: Debug + ZeroCopySend,
{
    builder
        .enable_safe_overflow(true)
        .subscriber_max_buffer_size(unread)
        .subscriber_max_borrowed_samples(HELD_MAX)
        .history_size(HISTORY)
        .max_publishers(1)
        .max_subscribers(SUBSCRIBERS_MAX)
        .max_nodes(NODES_MAX)
}

/// The transport's built-in settings, whatever files lie around, under a prefix of our own.
fn transport_config(run_id: &str) -> Result<Config, TopicError> {
    let mut config = Config::default();
    config.global.prefix = FileName::new(b"trocar_")
        .map_err(|error| TopicError::transport(run_id, "naming files", &format!("{error:?}")))?;
    // Only `remove_dead` cleans up.
    config.global.service.cleanup_dead_nodes_on_open = false;
    config.global.node.cleanup_dead_nodes_on_creation = false;
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    Ok(config)
}

/// Frees what dead processes still hold, what the transport would pass over first; the number of
/// them.
fn remove_dead(node: &Node<Service>) -> u64 {
    let global = &node.config().global;
    let folder = global.node_dir().to_string();
    let tags = [global.node.port_tag_suffix, global.node.service_tag_suffix];
    let tags = tags.map(|suffix| suffix.to_string());
    let _listed = Node::<Service>::list(node.config(), |state| {
        if matches!(state, NodeState::Dead(_)) {
            let id = state.node_id().value().to_string();
            unfinished::remove_tags(&Path::new(&folder).join(id), &tags);
        }
        CallbackProgression::Continue
    });
    node.blocking_cleanup_dead_nodes(CLEANUP_TIMEOUT).cleanups
}

/// Checks that `run_id` can name a run.
///
/// # Errors
/// [`TopicError::BadName`].
pub fn check_run_id(run_id: &str) -> Result<(), TopicError> {
    check_name(run_id, false)
}

/// Why nothing can be put into the folder `dir`, if that is so.
fn unwritable(dir: &Path) -> Option<TopicError> {
    let probe = dir.join(format!("trocar_probe_{}", std::process::id()));
    let tried = fs::create_dir_all(dir).and_then(|()| fs::write(&probe, ""));
    let _gone = fs::remove_file(&probe);
    let source = tried.err()?;
    let dir = dir.to_path_buf();
    Some(TopicError::Folder { dir, source })
}

fn check_name(name: &str, with_parts: bool) -> Result<(), TopicError> {
    let plain = |part: &str| {
        !part.is_empty()
            && part
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_')
    };
    let good = if with_parts {
        name.split('/').all(plain)
    } else {
        plain(name)
    };
    if good && name.len() <= NAME_MAX {
        return Ok(());
    }
    Err(TopicError::BadName {
        name: name.to_owned(),
        max: NAME_MAX,
    })
}

/// Whether a peer is creating or removing the service at this moment.
fn is_transient(error: ServiceError) -> bool {
    matches!(
        error,
        ServiceError::SystemInFlux
            | ServiceError::PublishSubscribeOpenError(
                OpenError::IsMarkedForDestruction
                    | OpenError::HangsInCreation
                    | OpenError::DoesNotExist
            )
            | ServiceError::PublishSubscribeCreateError(
                CreateError::IsBeingCreatedByAnotherInstance
                    | CreateError::HangsInCreation
                    | CreateError::AlreadyExists
            )
    )
}

fn service_error(topic: &str, error: ServiceError) -> TopicError {
    if matches!(
        error,
        ServiceError::PublishSubscribeOpenError(OpenError::IncompatibleTypes)
    ) {
        return TopicError::OtherType {
            topic: topic.to_owned(),
        };
    }
    TopicError::transport(topic, "opening the service", &error)
}

fn publisher_error(topic: &str, needed_bytes: u64, error: PublisherCreateError) -> TopicError {
    let topic = topic.to_owned();
    if error == PublisherCreateError::ExceedsMaxSupportedPublishers {
        return TopicError::AlreadyPublished { topic };
    }
    let space = shm::shared_memory_space();
    if let (PublisherCreateError::UnableToCreateDataSegment, Some(space)) = (error, space) {
        return TopicError::SharedMemoryTooSmall {
            topic,
            dir: SHARED_MEMORY_DIR,
            needed_bytes,
            free_bytes: space.free_bytes,
            total_bytes: space.total_bytes,
        };
    }
    TopicError::transport(&topic, "publishing", &error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let folder = std::env::temp_dir().join(format!("trocar-topics-{}", std::process::id()));
        assert!(unwritable(&folder).is_none());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        let file = folder.join("file");
        fs::write(&file, "").unwrap();
        let told = unwritable(&file.join("nodes")).unwrap().to_string();
        assert!(told.starts_with(&format!("{}", file.display())), "{told}");
        assert!(told.contains("may belong to another user"), "{told}");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn names_that_would_leave_the_run_are_refused() {
        for bad in [
            "",
            "a b",
            "a/../b",
            "a//b",
            "/a",
            "ä",
            &"x".repeat(NAME_MAX + 1),
        ] {
            assert!(check_name(bad, true).is_err(), "{bad}");
        }
        assert!(check_name("psm1/endoscope_left", true).is_ok());
        assert!(check_name("a/b", false).is_err());
    }
}
