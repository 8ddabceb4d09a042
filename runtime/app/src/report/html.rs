//! A report as one HTML file that asks for nothing else. It stands alone in one file: style, plots
//! and pictures are in it, it has no script, and its content security policy lets nothing be loaded
//! from elsewhere.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::document::{Block, Inline, TableCell, Tone};

/// Colours by the reader's choice; on paper always dark on white.
const STYLE: &str = "
:root { color-scheme: light dark; --page: #ffffff; --ink: #1c1e21; --faint: #5d646d; --line: #d5d9de; --head: #f1f3f5; --good: #1c7c43; --bad: #b3261e; }
@media (prefers-color-scheme: dark) { :root { --page: #14161a; --ink: #e6e8eb; --faint: #a2a9b3; --line: #363b43; --head: #1f2329; --good: #6fcf97; --bad: #ff8a80; } }
@media print { :root { color-scheme: light; --page: #ffffff; --ink: #000000; --faint: #444444; --line: #999999; --head: #eeeeee; --good: #0b5c2b; --bad: #8a1811; } }
* { box-sizing: border-box; }
body { background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 0 auto; padding: 1.5rem; }
h1 { font-size: 1.7rem; line-height: 1.25; } h2 { font-size: 1.3rem; margin-top: 2.2rem; border-bottom: 1px solid var(--line); } h3 { font-size: 1.05rem; }
a { color: inherit; } code, pre { font: 0.86em/1.45 ui-monospace, monospace; } pre { overflow-x: auto; background: var(--head); padding: 0.8rem; white-space: pre-wrap; }
.table { overflow-x: auto; } table { border-collapse: collapse; margin: 0.6rem 0; font-variant-numeric: tabular-nums; }
th, td { border: 1px solid var(--line); padding: 0.3rem 0.6rem; text-align: left; vertical-align: top; } th { background: var(--head); }
td.number { text-align: right; } td div + div { font-size: 0.86em; } small { color: var(--faint); font-size: 0.9em; }
td.reached strong { color: var(--good); } td.below strong { color: var(--bad); }
figure { display: inline-block; margin: 0.5rem 1rem 0.5rem 0; max-width: 100%; vertical-align: top; } figure svg, figure img { max-width: 100%; height: auto; display: block; color: var(--ink); }
figcaption { color: var(--faint); font-size: 0.88em; } summary { cursor: pointer; } details { margin: 0.4rem 0; }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } figure, tr { break-inside: avoid; } h2, h3 { break-after: avoid; } details::details-content { content-visibility: visible; block-size: auto; } .table { overflow: visible; } }
";

/// Only what is in the page itself may be shown.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

/// The page.
#[must_use]
pub fn page(title: &str, blocks: &[Block]) -> String {
    let mut body = String::new();
    for block in blocks {
        add(&mut body, block);
    }
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
        escape(title)
    )
}

/// Levels beyond 3 are 3, and 0 is 1.
fn add(body: &mut String, block: &Block) {
    match block {
        Block::Heading(level, text) => {
            let level = (*level).clamp(1, 3);
            body.push_str(&format!("<h{level}>{}</h{level}>\n", escape(text)));
        }
        Block::Paragraph(line) => {
            body.push_str(&format!("<p>{}</p>\n", inlines(line)));
        }
        Block::Table { head, rows } => table(body, head, rows),
        Block::Plot { title, svg } => body.push_str(&plot(title, svg)),
        Block::Picture { title, png } => body.push_str(&picture(title, png)),
        Block::Details(summary, blocks) => details(body, summary, blocks),
        Block::Verbatim(text) => {
            body.push_str(&format!("<pre>{}</pre>\n", escape(text)));
        }
    }
}

fn details(body: &mut String, summary: &str, blocks: &[Block]) {
    body.push_str(&format!(
        "<details><summary>{}</summary>\n",
        escape(summary)
    ));
    for block in blocks {
        add(body, block);
    }
    body.push_str("</details>\n");
}

/// The SVG stands in the page itself, so that it takes the page's colours; its title is what a
/// screen reader says.
fn plot(title: &str, svg: &str) -> String {
    let title = escape(title);
    format!(
        "<figure role=\"img\" aria-label=\"{title}\">{svg}<figcaption>{title}</figcaption></figure>\n"
    )
}

/// As a data URL: a third larger than the PNG, and no file beside the page.
fn picture(title: &str, png: &[u8]) -> String {
    let (title, data) = (escape(title), STANDARD.encode(png));
    format!(
        "<figure><img alt=\"{title}\" src=\"data:image/png;base64,{data}\"><figcaption>{title}</figcaption></figure>\n"
    )
}

fn table(body: &mut String, head: &[String], rows: &[Vec<TableCell>]) {
    body.push_str("<div class=\"table\"><table>\n<thead><tr>");
    for name in head {
        body.push_str(&format!("<th scope=\"col\">{}</th>", escape(name)));
    }
    body.push_str("</tr></thead>\n<tbody>\n");
    for row in rows {
        body.push_str("<tr>");
        for cell in row {
            body.push_str(&table_cell(cell));
        }
        body.push_str("</tr>\n");
    }
    body.push_str("</tbody></table></div>\n");
}

/// A number is set to the right; the tone colours the rate alone.
fn table_cell(cell: &TableCell) -> String {
    let tone = match cell.tone {
        Tone::Plain => "",
        Tone::Reached => " reached",
        Tone::Below => " below",
    };
    let number = if cell.number { "number" } else { "text" };
    let lines = cell
        .lines
        .iter()
        .map(|line| format!("<div>{}</div>", inlines(line)));
    format!(
        "<td class=\"{number}{tone}\">{}</td>",
        lines.collect::<String>()
    )
}

fn inlines(line: &[Inline]) -> String {
    let mut text = String::new();
    for inline in line {
        text.push_str(&match inline {
            Inline::Text(plain) => escape(plain),
            Inline::Strong(strong) => format!("<strong>{}</strong>", escape(strong)),
            Inline::Small(small) => format!("<small>{}</small>", escape(small)),
            Inline::Code(code) => format!("<code>{}</code>", escape(code)),
            Inline::Link { text, target } => {
                format!(
                    "<a href=\"{}\">{}</a>",
                    escape(&address(target)),
                    escape(text)
                )
            }
        });
    }
    text
}

/// A relative path as an address: what has a meaning there is written in hexadecimal. Letters,
/// digits and `/-_.~` stay; every other byte of the UTF-8 is `%` and two digits.
#[must_use]
pub fn address(path: &str) -> String {
    let mut address = String::new();
    for byte in path.bytes() {
        let plain = byte.is_ascii_alphanumeric() || b"/-_.~".contains(&byte);
        if plain {
            address.push(char::from(byte));
        } else {
            address.push_str(&format!("%{byte:02X}"));
        }
    }
    address
}

/// `text` where markup is expected.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            plain => escaped.push(plain),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::document::{paragraph, plain};

    #[test]
    fn nothing_of_a_result_becomes_markup() {
        let evil = "<script>alert('1 & 2')</script>\"";
        let link = Inline::Link {
            text: evil.to_owned(),
            target: format!("a b/{evil}"),
        };
        let cell = TableCell {
            lines: vec![vec![link], plain(evil)],
            ..TableCell::default()
        };
        let blocks = [
            Block::Heading(1, evil.to_owned()),
            paragraph(evil),
            Block::Table {
                head: vec![evil.to_owned()],
                rows: vec![vec![cell]],
            },
            Block::Details(evil.to_owned(), vec![Block::Verbatim(evil.to_owned())]),
            Block::Picture {
                title: evil.to_owned(),
                png: vec![0, 255],
            },
        ];
        let page = page(evil, &blocks);
        assert!(
            !page.contains("<script") && !page.contains("alert('"),
            "{page}"
        );
        assert!(page.contains("a%20b/%3Cscript%3E"), "{page}");
        assert!(page.contains("base64,AP8="), "{page}");
    }
}
