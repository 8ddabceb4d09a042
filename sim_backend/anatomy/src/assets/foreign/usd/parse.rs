//! An OpenUSD text as a [`Layer`]. What is not needed is passed over unread.

use super::layer::{Attribute, FLATTEN, Heading, Layer, Prim};
use super::words::{Token, Words};

/// How deep prims may be nested, and the brackets of a value that is read.
const DEPTH_MAX: usize = 64;
const BRACKETS_MAX: usize = 4;

/// Most prims of a stage, most bytes of a prim's name, and most numbers and words of the attributes
/// that are read.
const PRIMS_MAX: usize = 1 << 14;
const NAME_MAX: usize = 256;
const VALUES_MAX: usize = 1 << 25;

/// What brings in other prims.
const ARCS: [&str; 7] = [
    "references",
    "payload",
    "inherits",
    "specializes",
    "variants",
    "variantSets",
    "subLayers",
];

/// What may be before a property's type or a list's key.
const QUALIFIERS: [&str; 8] = [
    "custom", "uniform", "varying", "config", "add", "append", "prepend", "delete",
];

/// The attributes that are read, besides those of transformations.
const READ: [&str; 14] = [
    "points",
    "faceVertexCounts",
    "faceVertexIndices",
    "orientation",
    "visibility",
    "purpose",
    "xformOpOrder",
    "primvars:displayColor",
    "material:binding",
    "info:id",
    "inputs:diffuseColor",
    "inputs:roughness",
    "inputs:clearcoat",
    "outputs:surface",
];

/// The stage that `text` is.
///
/// # Errors
/// What is wrong, with the line and the prim.
pub(super) fn layer(text: &str) -> Result<Layer<'_>, String> {
    let mut parser = Parser {
        words: Words::new(text),
        next: None,
        open: Vec::new(),
        prims: 0,
        values: 0,
    };
    parser.layer().map_err(|reason| {
        let (line, open) = (parser.words.line, parser.open.join("/"));
        format!("line {line}, /{open}: {reason}")
    })
}

struct Parser<'a> {
    words: Words<'a>,
    /// The next piece if it has been looked at.
    next: Option<Token<'a>>,
    /// Names of the prims that it is in.
    open: Vec<&'a str>,
    prims: usize,
    values: usize,
}

impl<'a> Parser<'a> {
    fn maybe(&mut self) -> Result<Option<Token<'a>>, String> {
        match self.next.take() {
            Some(token) => Ok(Some(token)),
            None => Ok(self.words.next()?),
        }
    }

    fn token(&mut self) -> Result<Token<'a>, String> {
        self.maybe()?
            .ok_or_else(|| "the file ends in the middle".to_owned())
    }

    /// Takes the next piece if it is `sign`.
    fn takes(&mut self, sign: char) -> Result<bool, String> {
        self.next = self.maybe()?;
        let is_it = self.next == Some(Token::Sign(sign));
        if is_it {
            self.next = None;
        }
        Ok(is_it)
    }

    fn expect(&mut self, sign: char) -> Result<(), String> {
        let token = self.token()?;
        let is_it = token == Token::Sign(sign);
        is_it.then_some(()).ok_or_else(|| unexpected(token))
    }

    fn word(&mut self) -> Result<&'a str, String> {
        match self.token()? {
            Token::Word(word) => Ok(word),
            token @ (Token::Text(_) | Token::Place(_) | Token::Asset | Token::Sign(_)) => {
                Err(unexpected(token))
            }
        }
    }

    fn layer(&mut self) -> Result<Layer<'a>, String> {
        let mut heading = Heading::default();
        if self.takes('(')? {
            heading = self.heading()?;
        }
        let mut prims = Vec::new();
        while let Some(token) = self.maybe()? {
            match token {
                Token::Word(specifier @ ("def" | "over" | "class")) => {
                    prims.push(self.prim(specifier)?);
                }
                Token::Word("reorder") => self.reorder()?,
                Token::Word(_)
                | Token::Text(_)
                | Token::Place(_)
                | Token::Asset
                | Token::Sign(_) => {
                    return Err(unexpected(token));
                }
            }
        }
        // What OpenUSD takes where a file says nothing.
        let (metres_per_unit, up_axis) = (heading.metres_per_unit, heading.up_axis);
        Ok(Layer {
            metres_per_unit: metres_per_unit.unwrap_or(0.01),
            up_axis: up_axis.unwrap_or("Y"),
            prims,
        })
    }

    fn prim(&mut self, specifier: &str) -> Result<Prim<'a>, String> {
        let line = self.words.line;
        let mut kind = "";
        let mut token = self.token()?;
        if let Token::Word(word) = token {
            kind = word;
            token = self.token()?;
        }
        let Token::Text(name) = token else {
            return Err(unexpected(token));
        };
        self.prims += 1;
        if name.len() > NAME_MAX || self.open.len() == DEPTH_MAX || self.prims > PRIMS_MAX {
            return Err(format!(
                "a stage has at most {PRIMS_MAX} prims, {DEPTH_MAX} deep, with names of {NAME_MAX} bytes"
            ));
        }
        self.open.push(name);
        let mut heading = Heading::default();
        if self.takes('(')? {
            heading = self.heading()?;
        }
        let mut prim = Prim {
            name,
            kind,
            line,
            is_active: specifier == "def" && !heading.is_off,
            attributes: Vec::new(),
            children: Vec::new(),
        };
        self.expect('{')?;
        while !self.takes('}')? {
            self.statement(&mut prim)?;
        }
        self.open.pop();
        Ok(prim)
    }

    /// What is in a prim: a child, or a property.
    fn statement(&mut self, prim: &mut Prim<'a>) -> Result<(), String> {
        if self.takes(';')? {
            return Ok(());
        }
        match self.word()? {
            specifier @ ("def" | "over" | "class") => prim.children.push(self.prim(specifier)?),
            "variantSet" => return Err(arc("variantSet")),
            "reorder" => self.reorder()?,
            first => prim.attributes.extend(self.property(first)?),
        }
        Ok(())
    }

    /// Passes over an order of names.
    fn reorder(&mut self) -> Result<(), String> {
        while !self.takes('=')? {
            self.word()?;
        }
        self.pass()
    }

    /// What is in the brackets behind a prim's name, or at the beginning of the file.
    fn heading(&mut self) -> Result<Heading<'a>, String> {
        let mut heading = Heading::default();
        while !self.takes(')')? {
            match self.token()? {
                Token::Sign(';' | ',') | Token::Text(_) => continue,
                Token::Word(word) if QUALIFIERS.contains(&word) || word == "reorder" => continue,
                Token::Word(key) if ARCS.contains(&key) => return Err(arc(key)),
                Token::Word(key @ ("metersPerUnit" | "upAxis" | "active")) => {
                    self.expect('=')?;
                    heading.set(&self.value(key)?)?;
                }
                Token::Word(_) => {
                    self.expect('=')?;
                    self.pass()?;
                }
                token @ (Token::Place(_) | Token::Asset | Token::Sign(_)) => {
                    return Err(unexpected(token));
                }
            }
        }
        Ok(heading)
    }

    /// A property that begins with the word `first`, if it is one of those that are read and has a
    /// value.
    fn property(&mut self, first: &'a str) -> Result<Option<Attribute<'a>>, String> {
        let (mut kind, mut is_deleted) = (first, false);
        while QUALIFIERS.contains(&kind) {
            is_deleted |= kind == "delete";
            kind = self.word()?;
        }
        if self.takes('[')? {
            self.expect(']')?;
        }
        let name = self.word()?;
        if self.takes('(')? {
            self.pass_to_end()?;
        }
        if !self.takes('=')? {
            return Ok(None);
        }
        let (base, suffix) = name.split_once('.').unwrap_or((name, ""));
        let is_read = READ.contains(&base) || base.starts_with("xformOp:");
        if is_read && suffix == "timeSamples" {
            return Err(format!("{base} moves with time, which is not read"));
        }
        let found = if is_read && !is_deleted {
            Some(self.value(name)?)
        } else if base == "primvars:skel:jointIndices" {
            return Err("it has a skin, which is not read".to_owned());
        } else {
            self.pass()?;
            None
        };
        if self.takes('(')? {
            self.pass_to_end()?;
        }
        Ok(found)
    }

    /// The value of `name`.
    fn value(&mut self, name: &'a str) -> Result<Attribute<'a>, String> {
        let mut value = Attribute {
            name,
            ..Attribute::default()
        };
        let (mut depth, mut bracket) = (0_usize, None);
        loop {
            match self.token()? {
                Token::Sign(open @ ('[' | '(')) if depth < BRACKETS_MAX => {
                    depth += 1;
                    bracket = (open == '(').then_some(value.numbers.len());
                }
                Token::Sign(close @ (']' | ')')) if depth > 0 => {
                    depth -= 1;
                    if let (')', Some(start)) = (close, bracket.take()) {
                        value.closed(start)?;
                    }
                }
                Token::Sign(',') if depth > 0 => continue,
                Token::Word(word) => value.push(word)?,
                Token::Text(word) | Token::Place(word) => value.words.push(word),
                Token::Asset => {}
                token @ Token::Sign(_) => return Err(unexpected(token)),
            }
            self.values += 1;
            if self.values > VALUES_MAX {
                return Err(format!("the stage has more than {VALUES_MAX} values"));
            }
            if depth == 0 {
                return Ok(value);
            }
        }
    }

    /// Passes over a value.
    fn pass(&mut self) -> Result<(), String> {
        match self.token()? {
            Token::Sign('[' | '(' | '{') => self.pass_to_end(),
            token @ Token::Sign(_) => Err(unexpected(token)),
            Token::Word(_) | Token::Text(_) | Token::Place(_) | Token::Asset => Ok(()),
        }
    }

    /// Passes over what is left in a bracket.
    fn pass_to_end(&mut self) -> Result<(), String> {
        let mut depth = 1_usize;
        while depth > 0 {
            match self.token()? {
                Token::Sign('[' | '(' | '{') => depth += 1,
                Token::Sign(']' | ')' | '}') => depth -= 1,
                Token::Sign(_)
                | Token::Word(_)
                | Token::Text(_)
                | Token::Place(_)
                | Token::Asset => {}
            }
        }
        Ok(())
    }
}

fn unexpected(token: Token<'_>) -> String {
    match token {
        Token::Word(word) => format!("{word:.40} is not expected here"),
        Token::Text(text) => format!("\"{text:.40}\" is not expected here"),
        Token::Place(place) => format!("<{place:.40}> is not expected here"),
        Token::Asset => "a file's name is not expected here".to_owned(),
        Token::Sign(sign) => format!("{sign:?} is not expected here"),
    }
}

fn arc(key: &str) -> String {
    format!("{key} is not read: {FLATTEN}")
}
