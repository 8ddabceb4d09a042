//! Damage to the bytes of a file, drawn from a seed.

use hal::random::SplitMix64;

/// Numbers that lengths and counts are fond of going wrong at.
const ODD: [u64; 8] = [
    0,
    1,
    0x7f,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7fff_ffff_ffff_ffff,
    u64::MAX,
];

/// `whole` with one kind of damage; the first and the last bytes, where formats keep their lengths,
/// are hit more often.
pub(crate) fn damaged(whole: &[u8], seed: u64) -> Vec<u8> {
    let mut random = SplitMix64::named("damage", seed);
    let mut bytes = whole.to_vec();
    let place = |random: &mut SplitMix64, length: usize| match random.below(4) {
        0 => random.below(length.min(64)),
        1 => length - 1 - random.below(length.min(256)),
        _ => random.below(length),
    };
    match random.below(7) {
        0 => bytes.truncate(random.below(whole.len())),
        1 => {
            for _ in 0..=random.below(8) {
                let at = place(&mut random, bytes.len());
                bytes[at] ^= 1 << random.below(8);
            }
        }
        2 => {
            for _ in 0..=random.below(4) {
                let at = place(&mut random, bytes.len());
                bytes[at] = u8::try_from(random.below(256)).unwrap();
            }
        }
        3 => {
            let at = place(&mut random, bytes.len());
            let width = [1, 4, 8][random.below(3)].min(bytes.len() - at);
            let odd = ODD[random.below(ODD.len())].to_le_bytes();
            bytes[at..at + width].copy_from_slice(&odd[..width]);
        }
        4 => {
            let at = place(&mut random, bytes.len());
            let end = at + random.below(bytes.len() - at);
            bytes.drain(at..end);
        }
        5 => {
            let at = place(&mut random, bytes.len());
            let end = at + random.below((bytes.len() - at).min(4096));
            let again = bytes[at..end].to_vec();
            bytes.splice(at..at, again);
        }
        _ => digits(&mut bytes, &mut random),
    }
    bytes
}

/// Puts another number in the place of one that is written in digits: sizes, offsets and shapes in
/// JSON.
fn digits(bytes: &mut Vec<u8>, random: &mut SplitMix64) {
    let starts: Vec<usize> = (1..bytes.len())
        .filter(|&at| bytes[at].is_ascii_digit() && !bytes[at - 1].is_ascii_digit())
        .collect();
    let Some(&start) = starts.get(random.below(starts.len())) else {
        return;
    };
    let length = bytes[start..]
        .iter()
        .take_while(|byte| byte.is_ascii_digit())
        .count();
    let other = match random.below(4) {
        0 => "-1".to_owned(),
        1 => "1e400".to_owned(),
        _ => ODD[random.below(ODD.len())].to_string(),
    };
    bytes.splice(start..start + length, other.into_bytes());
}
