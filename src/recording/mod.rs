//! Bytes to records and back: WAV, MCAP, CSV, protobuf and JSON. The codecs do no I/O of their own.
