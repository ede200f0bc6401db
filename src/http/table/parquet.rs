//! A table as a Parquet file: times in nanoseconds UTC, strings in UTF-8, numbers as nullable doubles. The
//! file's metadata has `unit.NAME` for each numeric column.

use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, TimeUnit, Type as PhysicalType};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::Result;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;

use super::{Column, Table, Values};

/// Writes the whole file.
pub(super) fn file(table: &Table) -> Result<Vec<u8>> {
    let fields: Result<Vec<_>> = table.columns.iter().map(|column| field(column).map(Arc::new)).collect();
    let schema = Type::group_type_builder("schema").with_fields(fields?).build()?;
    let units = table.columns.iter().filter_map(|column| {
        let unit = column.unit.as_ref()?;
        Some(KeyValue::new(format!("unit.{}", column.name), unit.clone()))
    });
    let properties = WriterProperties::builder()
        .set_key_value_metadata(Some(units.collect()))
        .set_created_by(concat!("flankwatch ", env!("CARGO_PKG_VERSION")).to_owned());
    let mut writer = SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties.build()))?;
    if table.rows() > 0 {
        let mut rows = writer.next_row_group()?;
        for column in &table.columns {
            write(&mut rows, &column.values)?;
        }
        rows.close()?;
    }
    writer.into_inner()
}

fn field(column: &Column) -> Result<Type> {
    let (physical, logical, repetition) = match column.values {
        Values::Times(_) => {
            let nanoseconds = LogicalType::timestamp(true, TimeUnit::NANOS);
            (PhysicalType::INT64, Some(nanoseconds), Repetition::REQUIRED)
        }
        Values::Words(_) => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String), Repetition::REQUIRED),
        Values::Numbers(_) => (PhysicalType::DOUBLE, None, Repetition::OPTIONAL),
    };
    Type::primitive_type_builder(&column.name, physical)
        .with_logical_type(logical)
        .with_repetition(repetition)
        .build()
}

fn write(rows: &mut SerializedRowGroupWriter<'_, Vec<u8>>, values: &Values) -> Result<()> {
    let Some(mut column) = rows.next_column()? else { return Ok(()) };
    match values {
        Values::Times(times) => {
            let times: Vec<i64> =
                times.iter().map(|time| i64::try_from(time.as_nanosecond()).unwrap_or(i64::MAX)).collect();
            column.typed::<Int64Type>().write_batch(&times, None, None)?;
        }
        Values::Words(words) => {
            let words: Vec<ByteArray> = words.iter().map(|word| ByteArray::from(word.as_str())).collect();
            column.typed::<ByteArrayType>().write_batch(&words, None, None)?;
        }
        Values::Numbers(numbers) => {
            let is_there: Vec<i16> = numbers.iter().map(|number| i16::from(!number.is_nan())).collect();
            let there: Vec<f64> = numbers.iter().copied().filter(|number| !number.is_nan()).collect();
            column.typed::<DoubleType>().write_batch(&there, Some(&is_there), None)?;
        }
    }
    column.close()
}
