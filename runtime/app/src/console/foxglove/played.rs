//! A log as a viewer is told of it: where a page of the console has scrubbed or played to, or else
//! in its own time, over and over.

use std::collections::BTreeMap;

use hal::TimeNs;

use super::super::log_view::LogView;
use super::super::viewers::Message;

/// Where a viewer is in a log.
#[derive(Default)]
pub(super) struct Played {
    /// When it began, once it listens.
    begun: Option<TimeNs>,
    /// Where it is.
    at: Option<TimeNs>,
    /// Of when its newest message of a topic is.
    told: BTreeMap<String, TimeNs>,
}

impl Played {
    /// Goes on to `place`, s from the log's first tick, or where the time that is `now` leads: the
    /// log's time there and what is new of `topics`; nothing if it is there already.
    pub(super) fn go_on(
        &mut self,
        log: &LogView,
        (place, now): (Option<f64>, TimeNs),
        topics: &[&str],
    ) -> Option<(TimeNs, Vec<Message>)> {
        if topics.is_empty() {
            return None;
        }
        let begun = *self.begun.get_or_insert(now);
        let own = || TimeNs(now.since(begun)).seconds() % log.seconds().max(1.0);
        let at = log.time(place.unwrap_or_else(own));
        let fresh_topic = topics.iter().any(|topic| !self.told.contains_key(*topic));
        let before = self.at.replace(at);
        if before == Some(at) && !fresh_topic {
            return None;
        }
        let mut fresh = Vec::new();
        for topic in topics {
            let messages = log.messages(topic, before, at);
            let newest = messages.last().map_or(TimeNs(0), |message| message.at);
            if messages.is_empty() || self.told.get(*topic) != Some(&newest) {
                self.told.insert((*topic).to_owned(), newest);
                fresh.extend(messages);
            }
        }
        Some((at, fresh))
    }
}
