import schemathesis

for kind in ["offset+octet-stream", "mcap", "x-matlab-data", "x-npy", "x-protobuf"]:
    schemathesis.serializer.alias(f"application/{kind}", "application/octet-stream")
schemathesis.serializer.alias("audio/flac", "application/octet-stream")
schemathesis.serializer.alias("application/toml", "text/plain")


def without_fraction(value):
    """Whole numbers are sent as such: to JSON Schema 1.0 is an integer, to most readers of JSON it is not."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, list):
        return [without_fraction(item) for item in value]
    if isinstance(value, dict):
        return {name: without_fraction(item) for name, item in value.items()}
    return value


@schemathesis.hook
def map_body(context, body):
    return without_fraction(body)
