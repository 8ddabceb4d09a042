//! A report as blocks, before it is HTML or Markdown.

/// A piece of text.
#[derive(Clone, Debug, PartialEq)]
pub enum Inline {
    /// Plain text.
    Text(String),
    /// Text that stands out.
    Strong(String),
    /// Text in small print.
    Small(String),
    /// Text in a fixed-width face.
    Code(String),
    /// A link to a file, relative to the report.
    Link {
        /// What is shown.
        text: String,
        /// Where it leads.
        target: String,
    },
}

/// A line of text.
pub type Line = Vec<Inline>;

/// Plain text as a line.
#[must_use]
pub fn plain(text: impl Into<String>) -> Line {
    vec![Inline::Text(text.into())]
}

/// How a rate stands beside the published one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Tone {
    /// Nothing to say.
    #[default]
    Plain,
    /// At least the published rate.
    Reached,
    /// Below it.
    Below,
}

/// A cell of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TableCell {
    /// Its text, a line under the other.
    pub lines: Vec<Line>,
    /// How it stands.
    pub tone: Tone,
    /// Whether it is a number, which stands at the right.
    pub number: bool,
}

impl TableCell {
    /// A cell of text.
    #[must_use]
    pub fn text(text: impl Into<String>) -> Self {
        Self {
            lines: vec![plain(text)],
            ..Self::default()
        }
    }

    /// A cell of a number.
    #[must_use]
    pub fn number(text: impl Into<String>) -> Self {
        Self {
            number: true,
            ..Self::text(text)
        }
    }
}

/// A part of a report.
#[derive(Clone, Debug, PartialEq)]
pub enum Block {
    /// A heading of level 1 to 3.
    Heading(u8, String),
    /// A paragraph.
    Paragraph(Line),
    /// A table.
    Table {
        /// Its head.
        head: Vec<String>,
        /// Its rows.
        rows: Vec<Vec<TableCell>>,
    },
    /// A plot.
    Plot {
        /// What it shows, for those who don't see it.
        title: String,
        /// The picture, whose text is in the page's colour.
        svg: String,
    },
    /// A picture.
    Picture {
        /// What it shows.
        title: String,
        /// PNG.
        png: Vec<u8>,
    },
    /// What is shown when it is asked for.
    Details(String, Vec<Block>),
    /// Text as it is.
    Verbatim(String),
}

/// A text paragraph.
#[must_use]
pub fn paragraph(text: impl Into<String>) -> Block {
    Block::Paragraph(plain(text))
}
