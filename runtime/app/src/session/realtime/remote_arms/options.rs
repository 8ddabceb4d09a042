//! Which drives on CAN a run has.

use hal::config::Source;
use trocar_canopen::master::CanConfig;

use crate::session::SessionError;

/// Where the arms are and where their world, or their cameras, show themselves.
#[derive(Clone, Debug)]
pub struct CanOptions {
    /// Nodes and buses.
    pub config: CanConfig,
    /// The name of the topics of the world, or of the cameras.
    pub topics: String,
}

impl CanOptions {
    /// Reads nodes and buses from `source`; also gives their text, for the log.
    ///
    /// # Errors
    /// [`SessionError::Config`].
    pub fn load(source: &Source, topics: &str) -> Result<(Self, String), SessionError> {
        let options = Self {
            config: CanConfig::load(source)?,
            topics: topics.to_owned(),
        };
        Ok((options, source.text().to_owned()))
    }
}
