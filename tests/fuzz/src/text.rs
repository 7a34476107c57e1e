//! What people may be shown of a foreign text.

/// Checks that a text is short and has no control characters.
///
/// # Panics
/// If it is not.
pub(crate) fn check(text: &str, longest: usize) {
    let count = text.chars().count();
    assert!(count <= longest, "{count} characters are shown, of at most {longest}: {text:?}");
    assert!(!text.chars().any(char::is_control), "control characters are shown: {text:?}");
}

/// The next part of a text input, up to a line feed, and the rest.
pub(crate) fn line(data: &[u8]) -> (&[u8], &[u8]) {
    match data.iter().position(|byte| *byte == b'\n') {
        Some(at) => (&data[..at], &data[at + 1..]),
        None => (data, &[]),
    }
}
