//! Tables of codes that devices answer with.

/// Constants of a type that holds a code, with the texts of the standard's table.
macro_rules! codes {
    ($of:ident; $($(#[$doc:meta])* $name:ident = $code:literal, $text:literal;)*) => {
        impl $of {
            $($(#[$doc])* pub const $name: Self = Self($code);)*

            /// What the code says; none if the table lacks it.
            #[must_use]
            pub const fn text(self) -> Option<&'static str> {
                match self.0 {
                    $($code => Some($text),)*
                    _ => None,
                }
            }
        }
    };
}

pub(super) use codes;
