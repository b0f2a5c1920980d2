"""The sections of the report, each a pure function from the answer to blocks of text, tables and figures."""
