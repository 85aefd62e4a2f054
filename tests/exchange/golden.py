"""Bytes of the delta format that were once written and must be read for ever. Made by tests/exchange/make_golden.py."""

from __future__ import annotations

GOLDEN = {
    "elevation exact": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "00"
        # header length
        "01010000"
        # header, msgpack
        "9ba9656c65766174696f6e0104c0a272310202ce773594009294ff0000019400000002dc001092a16ea33c753492"
        "a57a5f6d696ea33c693492a57a5f6d6178a33c693492a573715f6869a33c753492a57a5f73756da33c693892a573"
        "715f6c6fa33c753892a57374616d70a33c693892a87265766973696f6ea33c753492a76368616e676573a33c7534"
        "92a66d6572676573a33c753492a867726f756e645f6ea33c753492ac67726f756e645f7a5f6d696ea33c693492ac"
        "67726f756e645f7a5f6d6178a33c693492ac67726f756e645f73715f6869a33c753492ac67726f756e645f7a5f73"
        "756da33c693892ac67726f756e645f73715f6c6fa33c7538923879"
        # body
        "28b52ffd20587d0100e8030000000200000040bafbffc0f2fcff00adf8ff00a030911bca9a3b01070080c18a014a"
        "5c95183443831803b00428b52ffd20b0850300d40400060002ff00404042d80ff600ff8000de3c00c0c020f91fe6"
        "0050f007b6a997e44001fe9436356577c40102fe40c00df203fc00ffb05024dbf01031ce06f98977916e31ce13ec"
        "00ff00ff00ff0e00c06b0d0456420203ce749e30b1439132737c77c351a37079572ce5da10c010"
        # CRC-32 of all before
        "0b7a2c92"
    ),
    "elevation full": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "01"
        # header length
        "1c000000"
        # header, msgpack
        "9ca9656c65766174696f6e0104c0a272310202ce7735940002030209"
        # body
        "0000010002e00884ba000c9b4b100a2004c0900980a006a8003b6001c2002e0b108506929348"
        # CRC-32 of all before
        "e8f883a4"
    ),
    "elevation lean": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "02"
        # header length
        "1c000000"
        # header, msgpack
        "9ca9656c65766174696f6e0104c0a272310202ce7735940002030209"
        # body
        "00000100c6a8003ae001ba002e0b108506929348"
        # CRC-32 of all before
        "ff8067b0"
    ),
    "grey exact": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "00"
        # header length
        "43000000"
        # header, msgpack
        "9ba4677265790104c0a272310202ce773594009194000000039492a161a33c753292a163a33c753292a872657669"
        "73696f6ea33c753492a57374616d70a33c69389136"
        # body
        "28b52ffd203c6d0100240200010300b2720096f356aa00fd020002ff0100ff0000009436ca35659a77c43bff0003"
        "0038b7afcbab0044"
        # CRC-32 of all before
        "963620bf"
    ),
    "grey full": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "01"
        # header length
        "17000000"
        # header, msgpack
        "9ca4677265790104c0a272310202ce7735940001030209"
        # body
        "00000100f6801ed003de00023000ae004d24cd2524"
        # CRC-32 of all before
        "b28c2718"
    ),
    "grey lean": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "02"
        # header length
        "17000000"
        # header, msgpack
        "9ca4677265790104c0a272310202ce7735940001030209"
        # body
        "000001000a81502e01e0f04d24cd2524"
        # CRC-32 of all before
        "d0f81fe8"
    ),
    "occupancy exact": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "00"
        # header length
        "56000000"
        # header, msgpack
        "9ba96f63637570616e63790104c0a272310202ce773594009294ff00000194000000049492a373756da33c693892"
        "a57374616d70a33c693892a775706461746573a33c753492a87265766973696f6ea33c753492253b"
        # body
        "28b52ffd201ce1000003000000192100000000000000ca9a3b00000000010000000100000028b52ffd2070950100"
        "0402000104010032f700f042ad003000ff0000000000943600003565000077c402020600c000047755c70ee5fddd"
        "4f06d002"
        # CRC-32 of all before
        "914e8e78"
    ),
    "occupancy full": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "01"
        # header length
        "1c000000"
        # header, msgpack
        "9ca96f63637570616e63790104c0a272310202ce7735940002050209"
        # body
        "000001001d21180a5000c00600ab128d06929348"
        # CRC-32 of all before
        "0ec7317e"
    ),
    "occupancy lean": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "02"
        # header length
        "1c000000"
        # header, msgpack
        "9ca96f63637570616e63790104c0a272310202ce7735940002050209"
        # body
        "0000010007483c0a20060780ab128d06929348"
        # CRC-32 of all before
        "acda0c1e"
    ),
    "terrain exact": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "00"
        # header length
        "d9000000"
        # header, msgpack
        "9ba77465727261696e0104c0a272310202ce773594009294ff00000194000000029c92a57374616d70a33c693892"
        "a6686569676874a33c663892aa6772616469656e745f78a33c663492aa6772616469656e745f79a33c663492ae67"
        "72616469656e745f6572726f72a33c663492aa6f636375706174696f6ea33c663492aa636f6e666964656e6365a3"
        "3c663492a5726976616ca33c663492a87265766973696f6ea33c753492a5666c616773a33c753292ab6770735f71"
        "75616c697479a37c753192ae636f6d6d756e69636174696f6e73a37c753192395b"
        # body
        "28b52ffd203485010034020300000000ca9a3b33f3bf8fc20d400ad7233c0000803f8e0b7e3d010000000b000000"
        "040020d2cc28dc5d59850b28b52ffd20689502000404000600ca009a003b003ec20af5d728a35c708f3dc2f00f3f"
        "008f71c23d0df240bf000af6d72823dc3cc380803fc0a99546e57efc3dff01000bf600ff0000000006002a430c45"
        "2966e0813c0081197003"
        # CRC-32 of all before
        "f2f40bdd"
    ),
    "terrain full": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "01"
        # header length
        "1a000000"
        # header, msgpack
        "9ca77465727261696e0104c0a272310202ce7735940002030109"
        # body
        "0000010006480490033016b980153f0010e00bb801ba00321b6db42141211348"
        # CRC-32 of all before
        "2cae92d0"
    ),
    "terrain lean": bytes.fromhex(
        # magic
        "544644"
        # format version
        "04"
        # form
        "02"
        # header length
        "1a000000"
        # header, msgpack
        "9ca77465727261696e0104c0a272310202ce7735940002030109"
        # body
        "000001001fc021c017700374006db42141211348"
        # CRC-32 of all before
        "ce573a0f"
    ),
}
