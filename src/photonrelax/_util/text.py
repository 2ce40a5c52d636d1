"""Text that any encoding of Unicode can hold."""


def encodable(text: str) -> str:
    r"""Text with what UTF-8 cannot hold, as in names of files that are no text, as ``\udcff``."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
