"""The gate: it checks what is proposed and alone moves main."""
