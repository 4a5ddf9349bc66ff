"""The document of a diagnosis: verdict, findings, schema, wording."""
