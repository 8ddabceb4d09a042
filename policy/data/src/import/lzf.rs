//! LZF, h5py's fast compression (`compression="lzf"`).
//!
//! A control byte below 32 is followed by that many bytes and one more, as they are. Any other
//! names a stretch of what is already there: its upper three bits the length less 2 (7: a byte
//! follows that adds to it), its lower five and the next byte how far back it begins, less 1.
//!
//! Lengths are stored less a constant because shorter stretches would not pay. The format has no
//! checksum and no length: the caller knows how much must come out.

/// The decompressed bytes, at most `most`; `None` if `packed` is damaged or holds more.
pub(super) fn decompress(packed: &[u8], most: usize) -> Option<Vec<u8>> {
    // Three bytes become at most 264.
    let mut out = Vec::with_capacity(most.min(packed.len().saturating_mul(88)));
    let mut rest = packed;
    while let [control, after @ ..] = rest {
        let control = usize::from(*control);
        rest = after;
        if control < 32 {
            let (literal, after) = rest.split_at_checked(control + 1)?;
            out.extend_from_slice(literal);
            rest = after;
        } else {
            rest = repeat(control, rest, &mut out)?;
        }
        if out.len() > most {
            return None;
        }
    }
    Some(out)
}

/// Appends a stretch of `out` again, as `control` and what follows it say; what follows after that.
///
/// Distances of up to 8192 bytes and lengths of 3 to 264. None if the stretch begins before the
/// output does.
fn repeat<'a>(control: usize, mut rest: &'a [u8], out: &mut Vec<u8>) -> Option<&'a [u8]> {
    let mut length = (control >> 5) + 2;
    if length == 9 {
        let (&more, after) = rest.split_first()?;
        length += usize::from(more);
        rest = after;
    }
    let (&low, after) = rest.split_first()?;
    let back = ((control & 31) << 8 | usize::from(low)) + 1;
    let start = out.len().checked_sub(back)?;
    // The stretch may reach into what it itself adds.
    for place in start..start + length {
        out.push(out[place]);
    }
    Some(after)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_and_stretches_come_back() {
        // "abc", then 3 from 3 back, then the last byte 300 times more: 7 + 2 + 291.
        let packed = [
            2,
            b'a',
            b'b',
            b'c',
            1 << 5,
            2,
            7 << 5,
            255,
            0,
            7 << 5,
            27,
            0,
        ];
        let mut expected = b"abcabc".to_vec();
        expected.extend([b'c'; 300]);
        assert_eq!(decompress(&packed, 306).unwrap(), expected);
        assert_eq!(decompress(&packed, 305), None, "more than there may be");
        for length in 1..packed.len() {
            let cut = decompress(&packed[..length], 306);
            let whole = [4, 6, 9].contains(&length);
            assert_eq!(cut.is_some(), whole, "{length}");
        }
        assert_eq!(decompress(&[1 << 5, 0], 9), None, "nothing is there yet");
    }
}
