//! What viewers are told beside pictures: the topics that there are, the newest messages of them,
//! and every line of what happened.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use axum::body::Bytes;
use hal::TimeNs;
use tokio::sync::watch;
use trocar_log::Level;
use trocar_log::live::{self, Channel};

/// Messages of what happened that whoever comes later is told.
const KEPT_MAX: usize = 256;

/// A message in the log's form.
#[derive(Clone, Debug)]
pub(super) struct Message {
    pub(super) topic: Cow<'static, str>,
    pub(super) at: TimeNs,
    pub(super) data: Bytes,
}

impl Message {
    pub(super) fn new(topic: &'static str, at: TimeNs, data: Vec<u8>) -> Self {
        Self {
            topic: topic.into(),
            at,
            data: data.into(),
        }
    }

    /// A line of `/events`.
    pub(super) fn event(at: TimeNs, level: Level, text: &str) -> Self {
        Self::new(live::EVENTS, at, live::event(at, level, text))
    }
}

/// The topics of what is shown, and its cameras in their order.
#[derive(Debug, Default)]
pub(super) struct Advertised {
    pub(super) channels: Vec<Channel>,
    pub(super) cameras: Vec<String>,
}

/// What all viewers share.
#[derive(Debug, Default)]
pub(super) struct Viewers {
    offer: watch::Sender<Arc<Advertised>>,
    newest: watch::Sender<Arc<Vec<Message>>>,
    /// The last that came of those that each viewer is to have, and how many there have been.
    happened: Mutex<VecDeque<Message>>,
    count: watch::Sender<u64>,
}

/// A viewer's ends.
pub(super) struct ViewerReceivers {
    pub(super) offer: watch::Receiver<Arc<Advertised>>,
    pub(super) newest: watch::Receiver<Arc<Vec<Message>>>,
    pub(super) happened: watch::Receiver<u64>,
}

impl Viewers {
    /// The ends of another viewer, to which all that is there is new.
    pub(super) fn join(&self) -> ViewerReceivers {
        let mut told = ViewerReceivers {
            offer: self.offer.subscribe(),
            newest: self.newest.subscribe(),
            happened: self.count.subscribe(),
        };
        told.offer.mark_changed();
        told.happened.mark_changed();
        told
    }

    /// Whether there is anybody.
    pub(super) fn any(&self) -> bool {
        self.newest.receiver_count() > 0
    }

    /// From now on these are the topics.
    pub(super) fn offer(&self, channels: Vec<Channel>, cameras: Vec<String>) {
        let offer = Advertised { channels, cameras };
        self.offer.send_replace(Arc::new(offer));
    }

    /// Tells the newest of each topic.
    pub(super) fn tell(&self, messages: Vec<Message>) {
        self.newest.send_replace(Arc::new(messages));
    }

    /// Tells what no viewer is to miss.
    pub(super) fn happened(&self, messages: Vec<Message>) {
        if messages.is_empty() {
            return;
        }
        let mut kept = self.happened.lock().unwrap_or_else(PoisonError::into_inner);
        let count = messages.len() as u64;
        kept.extend(messages);
        let surplus = kept.len().saturating_sub(KEPT_MAX);
        kept.drain(..surplus);
        self.count.send_modify(|all| *all += count);
    }

    /// What happened after the first `told`, as far as it is kept, and how much there has been.
    pub(super) fn since(&self, told: u64) -> (Vec<Message>, u64) {
        let kept = self.happened.lock().unwrap_or_else(PoisonError::into_inner);
        let all = *self.count.borrow();
        let fresh = usize::try_from(all.saturating_sub(told)).unwrap_or(usize::MAX);
        let surplus = kept.len().saturating_sub(fresh);
        (kept.iter().skip(surplus).cloned().collect(), all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whoever comes late hears what is kept, and everybody hears each message once.
    #[test]
    fn nothing_that_happened_is_missed_or_said_twice() {
        let viewers = Viewers::default();
        let line = |n: u64| Message::event(TimeNs(n), Level::Info, "said");
        viewers.happened(vec![line(0), line(1)]);
        let (first, told) = viewers.since(0);
        assert_eq!((first.len(), told), (2, 2));
        viewers.happened((2..5).map(line).collect());
        let (more, told) = viewers.since(told);
        let at: Vec<u64> = more.iter().map(|message| message.at.0).collect();
        assert_eq!((at, told), (vec![2, 3, 4], 5));
        viewers.happened((5..1000).map(line).collect());
        let (late, told) = viewers.since(0);
        assert_eq!((late.len(), told), (KEPT_MAX, 1000));
        assert!(viewers.since(told).0.is_empty());
    }
}
