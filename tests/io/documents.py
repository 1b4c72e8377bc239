"""What tests of readers do with parsed documents."""


def places_of(value, path=()):
    """Returns the path of every value inside a parsed document."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (*path, key)
        if isinstance(inner, (dict, list)):
            yield from places_of(inner, (*path, key))
