//! The MCAP records that a reader of vibration needs, as borrowed views. Every length is checked against the
//! available bytes before it is used.

use std::collections::BTreeMap;

/// Opcodes of the records that are read.
pub(crate) mod opcode {
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const DATA_END: u8 = 0x0f;
    pub(crate) const FOOTER: u8 = 0x02;
}

/// Longest name, topic or encoding, in bytes.
const MAX_NAME_BYTES: usize = 1024;

/// Description of the damage in a record; the error adds its position.
pub(crate) type Damage = String;

/// A cursor over a record's bytes.
struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    fn take(&mut self, what: &str, length: usize) -> Result<&'a [u8], Damage> {
        match self.rest.split_at_checked(length) {
            Some((taken, rest)) => {
                self.rest = rest;
                Ok(taken)
            }
            None => Err(format!("{what} needs {length} bytes, the record has {} left", self.rest.len())),
        }
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], Damage> {
        let taken = self.take(what, N)?;
        Ok(std::array::from_fn(|k| taken[k]))
    }

    fn u16(&mut self, what: &str) -> Result<u16, Damage> {
        Ok(u16::from_le_bytes(self.array(what)?))
    }

    fn u32(&mut self, what: &str) -> Result<u32, Damage> {
        Ok(u32::from_le_bytes(self.array(what)?))
    }

    fn u64(&mut self, what: &str) -> Result<u64, Damage> {
        Ok(u64::from_le_bytes(self.array(what)?))
    }

    fn text(&mut self, what: &str) -> Result<&'a str, Damage> {
        let length = self.u32(what)? as usize;
        if length > MAX_NAME_BYTES {
            return Err(format!("{what} has {length} bytes, expected at most {MAX_NAME_BYTES}"));
        }
        let bytes = self.take(what, length)?;
        std::str::from_utf8(bytes).map_err(|_| format!("{what} is not UTF-8"))
    }
}

/// A schema record; its data is not needed.
pub(crate) struct SchemaView<'a> {
    pub(crate) id: u16,
    pub(crate) name: &'a str,
}

impl<'a> SchemaView<'a> {
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, Damage> {
        let mut fields = Fields { rest: bytes };
        Ok(Self { id: fields.u16("a schema's id")?, name: fields.text("a schema's name")? })
    }
}

/// A channel record; its metadata is not needed.
pub(crate) struct ChannelView<'a> {
    pub(crate) id: u16,
    pub(crate) schema_id: u16,
    pub(crate) topic: &'a str,
    pub(crate) encoding: &'a str,
}

impl<'a> ChannelView<'a> {
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, Damage> {
        let mut fields = Fields { rest: bytes };
        Ok(Self {
            id: fields.u16("a channel's id")?,
            schema_id: fields.u16("a channel's schema id")?,
            topic: fields.text("a channel's topic")?,
            encoding: fields.text("a channel's message encoding")?,
        })
    }
}

/// A message record.
pub(crate) struct MessageView<'a> {
    pub(crate) channel_id: u16,
    pub(crate) sequence: u32,
    pub(crate) publish_time: u64,
    pub(crate) data: &'a [u8],
}

impl<'a> MessageView<'a> {
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, Damage> {
        let mut fields = Fields { rest: bytes };
        let channel_id = fields.u16("a message's channel id")?;
        let sequence = fields.u32("a message's sequence")?;
        fields.u64("a message's log time")?;
        let publish_time = fields.u64("a message's publish time")?;
        Ok(Self { channel_id, sequence, publish_time, data: fields.rest })
    }
}

/// A metadata record. Its entries are parsed on request.
pub(crate) struct MetadataView<'a> {
    pub(crate) name: &'a str,
    entries: &'a [u8],
}

impl<'a> MetadataView<'a> {
    pub(crate) fn parse(bytes: &'a [u8]) -> Result<Self, Damage> {
        let mut fields = Fields { rest: bytes };
        let name = fields.text("a metadata record's name")?;
        let length = fields.u32("a metadata record's length")? as usize;
        Ok(Self { name, entries: fields.take("a metadata record's entries", length)? })
    }

    pub(crate) fn entries(&self) -> Result<BTreeMap<&'a str, &'a str>, Damage> {
        let mut fields = Fields { rest: self.entries };
        let mut entries = BTreeMap::new();
        while !fields.rest.is_empty() {
            let key = fields.text("a metadata key")?;
            entries.insert(key, fields.text("a metadata value")?);
        }
        Ok(entries)
    }
}

/// Validates a chunk record before it is decompressed.
///
/// A decoder that trusts the inner lengths of an uncompressed chunk would read past its end, so they are
/// checked here. For a compressed chunk the declared size is limited.
pub(crate) fn check_chunk(bytes: &[u8], limit: usize) -> Result<(), Damage> {
    let mut fields = Fields { rest: bytes };
    fields.take("a chunk's times", 16)?;
    let uncompressed = fields.u64("a chunk's uncompressed size")?;
    fields.u32("a chunk's checksum")?;
    let compression = fields.text("a chunk's compression")?;
    let compressed = fields.u64("a chunk's compressed size")?;
    let available = fields.rest.len();
    fields.rest = usize::try_from(compressed)
        .ok()
        .and_then(|length| fields.rest.get(..length))
        .ok_or_else(|| format!("a chunk declares {compressed} bytes of records and has {available}"))?;
    if uncompressed > limit as u64 {
        return Err(format!("a chunk declares {uncompressed} bytes uncompressed, expected at most {limit}"));
    }
    if compression.is_empty() {
        while !fields.rest.is_empty() {
            fields.take("a record's opcode in a chunk", 1)?;
            let length = fields.u64("a record's length in a chunk")?;
            let length = usize::try_from(length)
                .map_err(|_| format!("a record in a chunk declares {length} bytes"))?;
            fields.take("a record in a chunk", length)?;
        }
    }
    Ok(())
}
