"""The estimate for people and programs: result.json, report, tables, pictures."""
