//! Colours of what is well, worth a look, bad, or no more than a frame around it. They are the
//! terminal's own colours, by number, so that they fit its scheme.

use ratatui::style::{Color, Modifier, Style};

pub(super) const QUIET: Style = Style::new().fg(Color::DarkGray);
pub(super) const GOOD: Style = Style::new().fg(Color::Green);
pub(super) const WARN: Style = Style::new().fg(Color::Yellow);
pub(super) const BAD: Style = Style::new().fg(Color::Red).add_modifier(Modifier::BOLD);
pub(super) const HEAD: Style = Style::new().add_modifier(Modifier::BOLD);
