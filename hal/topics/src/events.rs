//! Waking up: whoever publishes on a topic of a run tells those who wait for anything of it, so
//! that they need not look again and again.

use core::time::Duration;
use std::sync::Arc;

use iceoryx2::node::Node;
use iceoryx2::port::listener::Listener;
use iceoryx2::port::notifier::Notifier;
use iceoryx2::prelude::ServiceName;
use iceoryx2::service::builder::event::{
    EventCreateError as CreateError, EventOpenError as OpenError, EventOpenOrCreateError,
};
use iceoryx2::service::port_factory::event::PortFactory;

use super::TopicError;
use super::limits::{NODES_MAX, OPEN_TRIES, RETRY_PAUSE, Service};

/// Last part of the service's name.
const EVENTS: &str = "events";

/// The run's event service, through which its processes wake each other.
#[derive(Debug)]
pub(super) struct EventService {
    service: PortFactory<Service>,
    bell: Arc<Bell>,
}

/// Wakes everybody who waits for something of the run.
#[derive(Debug)]
pub(super) struct Bell(Notifier<Service>);

impl Bell {
    /// Never waits: a reader that has not woken yet is not told again.
    pub(super) fn ring(&self) {
        // Whoever can't be woken looks by itself after a while.
        let _woken = self.0.notify();
    }
}

/// Waits for anything that is published in the run, by any process of it.
#[derive(Debug)]
pub struct Events(Listener<Service>);

impl Events {
    /// Waits until something is published, a signal comes or `at_most_ns` have passed; what came
    /// since the last call ends it at once.
    ///
    /// There may be nothing new on the topics that one reads, and a peer that does not notify wakes
    /// no listener: look whenever this returns, and let it return often enough.
    pub fn wait(&self, at_most_ns: u64) {
        let _woken = self.0.timed_wait(|_| {}, Duration::from_nanos(at_most_ns));
    }
}

impl EventService {
    /// Opens or creates the service of the run `run_id`.
    pub(super) fn open(node: &Node<Service>, run_id: &str) -> Result<Self, TopicError> {
        let name = format!("trocar/{run_id}/{EVENTS}");
        let failed = |doing, error: &dyn core::fmt::Debug| {
            TopicError::transport(&name, doing, &format!("{error:?}"))
        };
        let service_name =
            ServiceName::new(&name).map_err(|error| failed("naming the service", &error))?;
        let mut tries = 0;
        let service = loop {
            let builder = node.service_builder(&service_name).event();
            let builder = builder
                .max_nodes(NODES_MAX)
                .max_notifiers(NODES_MAX)
                .max_listeners(NODES_MAX);
            match builder.open_or_create() {
                Ok(service) => break service,
                Err(error) if is_transient(error) && tries < OPEN_TRIES => tries += 1,
                Err(error) => return Err(failed("opening the service", &error)),
            }
            node.wait(RETRY_PAUSE)
                .map_err(|error| failed("waiting for a peer", &error))?;
        };
        let notifier = service.notifier_builder().create();
        let notifier = notifier.map_err(|error| failed("telling of what is published", &error))?;
        let bell = Arc::new(Bell(notifier));
        Ok(Self { service, bell })
    }

    pub(super) fn bell(&self) -> Arc<Bell> {
        Arc::clone(&self.bell)
    }

    /// A place to wait.
    pub(super) fn listen(&self) -> Result<Events, TopicError> {
        let listener = self.service.listener_builder().create();
        listener
            .map(Events)
            .map_err(|error| TopicError::transport(EVENTS, "waiting for events", &error))
    }
}

/// Whether a peer is creating or removing the service at this moment.
fn is_transient(error: EventOpenOrCreateError) -> bool {
    matches!(
        error,
        EventOpenOrCreateError::SystemInFlux
            | EventOpenOrCreateError::EventOpenError(
                OpenError::IsMarkedForDestruction
                    | OpenError::HangsInCreation
                    | OpenError::DoesNotExist
            )
            | EventOpenOrCreateError::EventCreateError(
                CreateError::IsBeingCreatedByAnotherInstance | CreateError::AlreadyExists
            )
    )
}
