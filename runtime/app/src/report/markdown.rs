//! A report as Markdown, with its plots and pictures as files in a folder beside it. It is
//! CommonMark with tables of GitHub's kind, and some HTML where Markdown has no word: folded parts
//! and lines within a cell.

use super::document::{Block, Inline, TableCell, Tone};
use super::html::address;

/// A file that the text shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Attachment {
    /// Its name in the folder.
    pub name: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// The text, and the files that belong into `folder` beside it.
#[must_use]
pub fn text(blocks: &[Block], folder: &str) -> (String, Vec<Attachment>) {
    let mut writer = Writer {
        text: String::new(),
        folder: address(folder),
        files: Vec::new(),
    };
    for block in blocks {
        writer.add(block);
    }
    (writer.text, writer.files)
}

/// The page as it grows.
struct Writer {
    text: String,
    folder: String,
    files: Vec<Attachment>,
}

impl Writer {
    fn add(&mut self, block: &Block) {
        match block {
            Block::Heading(level, text) => {
                let marks = "#".repeat(usize::from((*level).clamp(1, 3)));
                self.text.push_str(&format!("{marks} {}\n\n", escape(text)));
            }
            Block::Paragraph(line) => self.text.push_str(&format!("{}\n\n", inlines(line))),
            Block::Table { head, rows } => self.table(head, rows),
            Block::Plot { title, svg } => self.attach(title, "svg", coloured(svg).into_bytes()),
            Block::Picture { title, png } => self.attach(title, "png", png.clone()),
            Block::Details(summary, blocks) => self.details(summary, blocks),
            Block::Verbatim(text) => {
                let fence = "`".repeat(longest_run(text).max(2) + 1);
                self.text
                    .push_str(&format!("{fence}text\n{}\n{fence}\n\n", text.trim_end()));
            }
        }
    }

    fn details(&mut self, summary: &str, blocks: &[Block]) {
        self.text.push_str(&format!(
            "<details><summary>{}</summary>\n\n",
            escape(summary)
        ));
        for block in blocks {
            self.add(block);
        }
        self.text.push_str("</details>\n\n");
    }

    fn table(&mut self, head: &[String], rows: &[Vec<TableCell>]) {
        let row = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        self.text
            .push_str(&row(head.iter().map(|name| escape(name)).collect()));
        self.text
            .push_str(&row(head.iter().map(|_| "---".to_owned()).collect()));
        for cells in rows {
            self.text.push_str(&row(cells.iter().map(cell).collect()));
        }
        self.text.push('\n');
    }

    /// The file gets the next number as its name, so that a page is the same each time it is
    /// written.
    fn attach(&mut self, title: &str, kind: &str, bytes: Vec<u8>) {
        let name = format!("{:03}.{kind}", self.files.len() + 1);
        self.text
            .push_str(&format!("![{}]({}/{name})\n\n", escape(title), self.folder));
        self.files.push(Attachment { name, bytes });
    }
}

/// A cell's lines with breaks; Markdown has no colours, so that one below the published rate says
/// so.
fn cell(cell: &TableCell) -> String {
    let lines: Vec<String> = cell.lines.iter().map(|line| inlines(line)).collect();
    let tone = match cell.tone {
        Tone::Plain | Tone::Reached => "",
        Tone::Below => " (below)",
    };
    format!("{}{tone}", lines.join("<br>"))
}

fn inlines(line: &[Inline]) -> String {
    let mut text = String::new();
    for inline in line {
        text.push_str(&match inline {
            Inline::Text(plain) | Inline::Small(plain) => escape(plain),
            Inline::Strong(strong) => format!("**{}**", escape(strong)),
            Inline::Code(code) => format!("`{}`", code.replace('`', "'")),
            Inline::Link { text, target } => format!("[{}]({})", escape(text), address(target)),
        });
    }
    text
}

/// `svg` with colours of its own: alone, a plot has no page whose colours it could take.
fn coloured(svg: &str) -> String {
    svg.replacen(
        "<svg ",
        "<svg style=\"color:#1c1e21;background:#ffffff\" ",
        1,
    )
}

/// The longest row of back quotes. A fence around a text has to be longer.
fn longest_run(text: &str) -> usize {
    text.split(|c| c != '`').map(str::len).max().unwrap_or(0)
}

/// `text` where markup is expected. A line break becomes a space: it would end a table's row.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '\\' | '|' | '*' | '_' | '`' | '[' | ']' | '#' => {
                escaped.push('\\');
                escaped.push(c);
            }
            '<' => escaped.push_str("&lt;"),
            '&' => escaped.push_str("&amp;"),
            '\n' => escaped.push(' '),
            plain => escaped.push(plain),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::document::paragraph;

    #[test]
    fn a_table_keeps_its_columns_and_pictures_become_files() {
        let bar = TableCell::text("a | b\n*c*");
        let below = TableCell {
            tone: Tone::Below,
            ..TableCell::number("0.5")
        };
        let blocks = [
            paragraph("one_two"),
            Block::Table {
                head: vec!["x".to_owned(), "y".to_owned()],
                rows: vec![vec![bar, below]],
            },
            Block::Plot {
                title: "p".to_owned(),
                svg: "<svg width=\"1\"/>".to_owned(),
            },
            Block::Verbatim("```\n".to_owned()),
        ];
        let (text, files) = text(&blocks, "r files");
        assert!(text.contains("one\\_two"), "{text}");
        assert!(
            text.contains("| x | y |\n| --- | --- |\n| a \\| b \\*c\\* | 0.5 (below) |\n"),
            "{text}"
        );
        assert!(text.contains("![p](r%20files/001.svg)"), "{text}");
        assert!(text.contains("````text\n```\n````"), "{text}");
        assert_eq!((files.len(), files[0].name.as_str()), (1, "001.svg"));
    }
}
