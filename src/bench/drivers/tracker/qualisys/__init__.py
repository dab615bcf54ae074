"""Qualisys Track Manager (QTM) through Qualisys' own client library, which is an extra: `client` alone needs it."""
