//! The words of an OpenUSD text, one after the other.

/// A piece of the text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Token<'a> {
    /// A name, with its namespaces and its suffix, or a number.
    Word(&'a str),
    /// A text in quotation marks, as it is between them.
    Text(&'a str),
    /// A place in the stage, without its brackets.
    Place(&'a str),
    /// Another file.
    Asset,
    /// A bracket or another sign.
    Sign(char),
}

/// What is left of the text.
#[derive(Debug)]
pub(super) struct Words<'a> {
    rest: &'a str,
    /// The line that `rest` begins in.
    pub(super) line: usize,
}

fn is_word(sign: char) -> bool {
    sign.is_alphanumeric() || "_:.+-!".contains(sign) || !sign.is_ascii()
}

impl<'a> Words<'a> {
    pub(super) const fn new(text: &'a str) -> Self {
        let (rest, line) = (text, 1);
        Self { rest, line }
    }

    /// Takes as many bytes, which end where a character does.
    fn take(&mut self, bytes: usize) -> &'a str {
        let (taken, rest) = self.rest.split_at(bytes);
        self.line += taken.matches('\n').count();
        self.rest = rest;
        taken
    }

    /// Takes blanks and comments.
    fn skip_blank(&mut self) {
        loop {
            let blank = self.rest.len() - self.rest.trim_ascii_start().len();
            self.take(blank);
            if !self.rest.starts_with('#') {
                return;
            }
            let comment = self.rest.find('\n').unwrap_or(self.rest.len());
            self.take(comment);
        }
    }

    /// Takes what is between `mark` and the next one that no backslash is before; `None` if there
    /// is none.
    fn quoted(&mut self, mark: &str) -> Option<&'a str> {
        self.take(mark.len());
        let mut from = 0;
        loop {
            let end = from + self.rest[from..].find(mark)?;
            let inner = &self.rest[..end];
            let backslashes = inner.len() - inner.trim_end_matches('\\').len();
            if backslashes.is_multiple_of(2) {
                self.take(end + mark.len());
                return Some(inner);
            }
            from = end + 1;
        }
    }

    /// The next piece; none at the end.
    ///
    /// # Errors
    /// What has no end.
    pub(super) fn next(&mut self) -> Result<Option<Token<'a>>, &'static str> {
        self.skip_blank();
        let Some(first) = self.rest.chars().next() else {
            return Ok(None);
        };
        if is_word(first) {
            let end = self.rest.find(|sign| !is_word(sign));
            let word = self.take(end.unwrap_or(self.rest.len()));
            return Ok(Some(Token::Word(word)));
        }
        let long = |mark: &'static str, short| {
            if self.rest.starts_with(mark) {
                mark
            } else {
                short
            }
        };
        let token = match first {
            '"' => {
                let mark = long("\"\"\"", "\"");
                self.quoted(mark).map(Token::Text)
            }
            '\'' => {
                let mark = long("'''", "'");
                self.quoted(mark).map(Token::Text)
            }
            '@' => {
                let mark = long("@@@", "@");
                self.quoted(mark).map(|_| Token::Asset)
            }
            '<' => {
                self.take(1);
                self.rest.find('>').map(|end| {
                    let place = self.take(end);
                    self.take(1);
                    Token::Place(place)
                })
            }
            sign => {
                self.take(sign.len_utf8());
                Some(Token::Sign(sign))
            }
        };
        let endless = "a text, a path or a file's name has no end";
        token.map(Some).ok_or(endless)
    }
}
