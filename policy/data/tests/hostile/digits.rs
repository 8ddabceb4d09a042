//! Every number of a text file in turn, replaced by each that sizes and counts go wrong at.

/// What takes a number's place.
const OTHERS: [&str; 12] = [
    "0",
    "-1",
    "0.5",
    "1e400",
    "1e18",
    "2147483648",
    "1000000000000",
    "9223372036854775807",
    "18446744073709551615",
    "99999999999999999999999999",
    "null",
    "[1e15]",
];

/// The texts that come of `text` by replacing one number, with what was replaced by what.
pub(crate) fn renumbered(text: &str) -> Vec<(String, String)> {
    let bytes = text.as_bytes();
    let within = |byte: u8| byte.is_ascii_digit() || matches!(byte, b'-' | b'+' | b'.' | b'e');
    let mut all = Vec::new();
    let mut at = 0;
    while at < bytes.len() {
        // A number stands behind a colon, a comma, a bracket or a space, not within a word.
        let opens = at > 0 && matches!(bytes[at - 1], b':' | b',' | b'[' | b' ');
        if !(opens && (bytes[at].is_ascii_digit() || bytes[at] == b'-')) {
            at += 1;
            continue;
        }
        let length = bytes[at..].iter().take_while(|&&byte| within(byte)).count();
        let (before, number, after) = (&text[..at], &text[at..at + length], &text[at + length..]);
        for other in OTHERS {
            let line = before.lines().count();
            let case = format!("line {line}: {number} -> {other}");
            all.push((case, format!("{before}{other}{after}")));
        }
        at += length;
    }
    all
}
