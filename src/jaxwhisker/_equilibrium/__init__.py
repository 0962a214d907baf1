"""The dimensionless problem: contact, touch, Newton steps, stability, implicit derivatives."""
