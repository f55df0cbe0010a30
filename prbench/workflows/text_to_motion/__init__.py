"""The text-to-motion evaluator: trained, stored, and asked about any table (Prime and Reach, section F)."""
