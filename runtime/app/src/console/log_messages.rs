//! A log's own messages in memory, for viewers: of most topics the newest of each twentieth of a
//! second.

use std::collections::BTreeMap;

use axum::body::Bytes;
use hal::TimeNs;
use trocar_log::live;

use super::viewers::Message;

/// Time from one message of a topic that is kept to the next, at first, ns.
const EVERY_NS: u64 = 50_000_000;

/// Bytes of messages that are kept, of some twenty minutes of one arm; of longer logs they are
/// further apart.
const BYTES_MAX: usize = 64 << 20;

/// Topics of which all messages are kept, since one does not say what another said.
const WHOLE: [&str; 2] = [live::EVENTS, live::TRANSFORMS];

/// How far back the messages of such a topic are told after a jump, and how much of the time may
/// pass at once without being one, ns.
const LOOK_BACK_NS: u64 = 200_000_000;
const STEP_NS_MAX: u64 = 2_000_000_000;

/// Messages by topic and time.
#[derive(Debug)]
pub(super) struct LogMessages {
    /// Several of a topic may be of one time.
    topics: BTreeMap<String, BTreeMap<(TimeNs, u64), Bytes>>,
    bytes: usize,
    every_ns: u64,
    count: u64,
}

impl Default for LogMessages {
    fn default() -> Self {
        Self {
            topics: BTreeMap::new(),
            bytes: 0,
            every_ns: EVERY_NS,
            count: 0,
        }
    }
}

impl LogMessages {
    /// Copies `data` if it is kept; a topic's first message always is, and each of `WHOLE`.
    pub(super) fn keep(&mut self, topic: &str, at: TimeNs, data: &[u8]) {
        if !self.topics.contains_key(topic) {
            self.topics.insert(topic.to_owned(), BTreeMap::new());
        }
        let Some(kept) = self.topics.get_mut(topic) else {
            return;
        };
        let newest = kept.last_key_value().map(|((newest, _), _)| *newest);
        let due = newest.is_none_or(|newest| at.since(newest) >= self.every_ns);
        if due || WHOLE.contains(&topic) {
            self.bytes += data.len();
            self.count += 1;
            kept.insert((at, self.count), Bytes::copy_from_slice(data));
        }
        if self.bytes > BYTES_MAX {
            self.thin_out();
        }
    }

    /// Lets every second message go, but for events, which are few.
    fn thin_out(&mut self) {
        self.every_ns *= 2;
        for (topic, kept) in &mut self.topics {
            if topic == live::EVENTS {
                continue;
            }
            let mut index = 0;
            kept.retain(|_, _| {
                index += 1;
                index % 2 == 1
            });
        }
        let sizes = self.topics.values().flat_map(BTreeMap::values);
        self.bytes = sizes.map(Bytes::len).sum();
    }

    /// What `topic` says of the time from `before` (not itself) to `at`, if time goes on a little,
    /// or else of `at` alone.
    pub(super) fn at(&self, topic: &str, before: Option<TimeNs>, at: TimeNs) -> Vec<Message> {
        let Some(kept) = self.topics.get(topic) else {
            return Vec::new();
        };
        let earliest = TimeNs(at.0.saturating_sub(LOOK_BACK_NS));
        let until = kept.range(..=(at, u64::MAX));
        let message = |((at, _), data): (&(TimeNs, u64), &Bytes)| Message {
            topic: topic.to_owned().into(),
            at: *at,
            data: data.clone(),
        };
        if WHOLE.contains(&topic) {
            let goes_on = |before: &TimeNs| *before <= at && at.since(*before) <= STEP_NS_MAX;
            let after = before.filter(goes_on);
            let after = after.unwrap_or(earliest);
            let fresh = until.filter(|((at, _), _)| *at > after || before.is_none());
            return fresh.map(message).collect();
        }
        until.last().map(message).into_iter().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(messages: &LogMessages, topic: &str, before: Option<u64>, at: u64) -> Vec<u64> {
        let ms = |ms: u64| TimeNs(ms * 1_000_000);
        let told = messages.at(topic, before.map(ms), ms(at));
        told.iter()
            .map(|message| message.at.0 / 1_000_000)
            .collect()
    }

    /// Events come once as time goes on, and not at all that were jumped over; of the other topics
    /// the newest is told.
    #[test]
    fn what_is_told_is_of_the_time_that_passes() {
        let mut messages = LogMessages::default();
        for ms in 0..2000 {
            messages.keep("/safety", TimeNs(ms * 1_000_000), b"{}");
        }
        for ms in [100, 110, 110, 1500] {
            messages.keep(live::EVENTS, TimeNs(ms * 1_000_000), b"line");
        }
        assert_eq!(told(&messages, "/safety", None, 1234), [1200]);
        assert_eq!(told(&messages, "/safety", Some(1900), 30), [0]);
        assert_eq!(told(&messages, live::EVENTS, Some(90), 105), [100]);
        assert_eq!(told(&messages, live::EVENTS, Some(105), 150), [110, 110]);
        assert!(told(&messages, live::EVENTS, Some(150), 160).is_empty());
        assert_eq!(told(&messages, live::EVENTS, Some(160), 1600), [1500]);
        assert!(told(&messages, live::EVENTS, Some(1600), 1000).is_empty());
        assert!(told(&messages, live::EVENTS, Some(0), 2500).is_empty());
        assert!(told(&messages, "/none", None, 10).is_empty());
    }

    #[test]
    fn messages_of_a_long_log_take_bounded_memory() {
        let mut messages = LogMessages::default();
        let data = vec![0; 64 << 10];
        for step in 0..3000 {
            messages.keep("/safety", TimeNs(step * EVERY_NS), &data);
        }
        assert!(messages.bytes <= BYTES_MAX && messages.bytes > BYTES_MAX / 4);
        assert!(messages.every_ns > EVERY_NS);
        assert_eq!(told(&messages, "/safety", None, 0), [0]);
    }
}
